"""What `verify` says of recordings, as objects for `--json` and as lines."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from robotctl.cli.terminal.text import moment, row, short_path, size
from robotctl.errors import RobotctlError
from robotctl.paths import check_robot_name, seal_folder
from robotctl.recording.format.seal_records import Opening
from robotctl.recording.read.seal_chain import Chain, SealedFile, check_chain, find_head
from robotctl.recording.read.seal_check import SealState
from robotctl.recording.read.verified import RecordingProof, VerifiedRecording
from robotctl.recording.read.whole_file import WholeFile
from robotctl.recording.seal.heads import HeadsList, read_heads

_LABEL_WIDTH = 12
_INDENT = " " * _LABEL_WIDTH
_KEY_DIGITS = 16

NOT_PROVED = (
    "who could use the key: at that time, each reader of the robot's state folder could",
    "what was recorded before the first file here",
    "that nothing was cut off behind the last head: give a later one with --head",
)


def recording_object(found: VerifiedRecording) -> dict[str, Any]:
    """Return the object of one recording."""
    whole = found.whole
    return {
        "path": str(whole.path),
        "verdict": found.proof.value,
        "files": [
            _file_object(file, sealed)
            for file, sealed in zip(whole.files, found.files, strict=True)
        ],
        "wrong": list(found.wrong),
        "unreadable": list(whole.unreadable),
        "notes": [
            *(
                f"{file.path.name}: not closed: {file.loose} bytes before its end hold no data"
                for file in whole.files
                if file.loose
            ),
            *(f"{file.path.name}: {note}" for file in found.files for note in file.seal.notes),
            *found.chain.absent,
        ],
    }


def unreadable_object(path: Path, reason: str) -> dict[str, Any]:
    """Return the object of a recording of which nothing can be read."""
    return {
        "path": str(path),
        "verdict": RecordingProof.UNREADABLE.value,
        "files": [],
        "wrong": [],
        "unreadable": [reason],
        "notes": [],
    }


def summary_object(found: Sequence[VerifiedRecording], head: str) -> dict[str, Any]:
    """Return what holds for all recordings together: their chain, the head, what is not proved."""
    files = [file for each in found for file in each.files]
    chain = check_chain(files)
    within = {sentence for each in found for sentence in (*each.wrong, *each.chain.absent)}
    wrong = [sentence for sentence in chain.wrong if sentence not in within]
    notes = [sentence for sentence in chain.absent if sentence not in within]
    if head:
        holder = find_head(files, head)
        if holder is None:
            wrong.append("the given head is nowhere in it: a tail was cut, or it is another chain")
        else:
            notes.append(f"the given head is in {holder.path.name}")
    sealed = [file for file in files if file.seal.state is not SealState.NONE]
    notes += _named_here(chain, sealed)
    known, cut = _known_here(sealed)
    wrong += cut
    if known:
        notes.append(f"this machine's list of keys knows {known} of {len(sealed)} files")
    return {
        "wrong": wrong,
        "notes": notes,
        "not_proved": list(NOT_PROVED[: 2 if head else 3]) if sealed else [],
    }


def recording_lines(report: dict[str, Any]) -> Iterator[str]:
    """Yield the lines for one recording, from its object."""
    yield f"{report['verdict']:{_LABEL_WIDTH}}{short_path(report['path'])}"
    for file in report["files"]:
        count = f"{file['messages']} messages"
        yield from row(_INDENT, f"{file['name']}: {size(file['bytes'])}, {count}, {file['state']}")
        seal = file["seal"]
        if seal["links"]:
            yield from row(
                f"{_INDENT}  ",
                f"{seal['state']}, file {seal['number']} of {seal['root'][:_KEY_DIGITS]}, "
                f"key {seal['key'][:_KEY_DIGITS]}, "
                f"from {moment(seal['from_ns'])} to {moment(seal['to_ns'])}",
            )
    for name, label in (("wrong", "wrong"), ("unreadable", "not read"), ("notes", "note")):
        for sentence in report[name]:
            yield from row(_INDENT, f"{label}: {sentence}")


def summary_lines(summary: dict[str, Any]) -> Iterator[str]:
    """Yield the lines for all recordings together."""
    for name, label in (("wrong", "wrong"), ("notes", "note"), ("not_proved", "not proved")):
        for sentence in summary[name]:
            yield from row("", f"{label}: {sentence}")


def _file_object(file: WholeFile, sealed: SealedFile) -> dict[str, Any]:
    return {
        "name": file.path.name,
        "bytes": file.size,
        "messages": file.data.message_count,
        "state": file.state.value,
        "library": file.data.header.library,
        "flaws": [
            {"start": flaw.start, "end": flaw.end, "text": flaw.text} for flaw in file.flaws.kept
        ],
        "flaw_count": file.flaws.count,
        "seal": _seal_object(sealed),
    }


def _seal_object(sealed: SealedFile) -> dict[str, Any]:
    seal = sealed.seal
    opening, head = seal.opening, seal.head
    return {
        "state": seal.state.value,
        "robot": "" if opening is None else opening.robot,
        "root": "" if opening is None else opening.root,
        "number": 0 if opening is None else opening.number,
        "key": "" if opening is None else opening.key,
        "previous": "" if opening is None else opening.previous,
        "links": len(seal.links),
        "covered": 0 if head is None else head.covered,
        "head": "" if head is None else head.digest.hex(),
        "from_ns": 0 if opening is None else opening.time_ns,
        "to_ns": 0 if head is None else head.time_ns,
    }


def _known_here(files: Sequence[SealedFile]) -> tuple[int, list[str]]:
    """Return how many files the lists in this user's state folder know, and which were cut."""
    lists: dict[str, HeadsList] = {}
    known, cut = 0, []
    for file in files:
        opening = file.seal.opening
        if opening is None:
            continue
        if opening.robot not in lists:
            lists[opening.robot] = _heads_of(opening)
        heads = lists[opening.robot]
        known += heads.opened.get(opening.key) == opening
        closed = heads.closed.get(opening.key)
        if closed is not None and not file.seal.knows(closed.digest):
            name = file.path.name
            cut.append(f"{name}: this machine knows another end of it: a tail was cut or changed")
    return known, cut


def _named_here(chain: Chain, files: Sequence[SealedFile]) -> Iterator[str]:
    """Yield what the lists in this user's state folder know about the files that are missing."""
    robots = {
        file.seal.opening.root: file.seal.opening for file in files if file.seal.opening is not None
    }
    for root, number in chain.missing:
        name = _heads_of(robots[root]).named(root, number)
        if name:
            yield f"this machine's list of keys knows file {number}: it was {name}"


def _heads_of(opening: Opening) -> HeadsList:
    try:
        return read_heads(seal_folder(check_robot_name(opening.robot)))
    except RobotctlError:
        return HeadsList()
