"""What `verify` says of recordings, as objects for `--json` and as lines."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from robotctl.cli.terminal.text import moment, row, short_path, size
from robotctl.recording.read.known_heads import KnownHeads
from robotctl.recording.read.seal_chain import Chain, SealedFile, check_chain, find_head
from robotctl.recording.read.seal_check import SealState
from robotctl.recording.read.verified import RecordingProof, VerifiedRecording
from robotctl.recording.read.whole_file import WholeFile
from robotctl.recording.read.zstd_file import SUFFIX

_LABEL_WIDTH = 12
_INDENT = " " * _LABEL_WIDTH
_KEY_DIGITS = 16

NOT_PROVED = (
    "who could use the key: at that time, each reader of the robot's state folder could",
    "what was recorded before the first file here",
    "that nothing was cut off behind the last head: give a later one with --head",
)


def recording_object(found: VerifiedRecording, heads: KnownHeads) -> dict[str, Any]:
    """Return the object of one recording; `heads` is what this machine knows of such files."""
    whole = found.whole
    known = [(file.path.name, heads.compare(file)) for file in found.files]
    wrong = [*found.wrong, *(f"{name}: {each.wrong}" for name, each in known if each.wrong)]
    unproved = [f"{name}: {each.unproved}" for name, each in known if each.unproved]
    return {
        "path": str(whole.path),
        "verdict": (RecordingProof.BROKEN if wrong else found.proof).value,
        "files": [
            _file_object(file, sealed)
            for file, sealed in zip(whole.files, found.files, strict=True)
        ],
        "wrong": wrong,
        "unreadable": list(whole.unreadable),
        "unproved": unproved,
        "notes": [
            *unproved,
            *(
                f"{file.path.name}: it was sealed as {file.seal.opening.file}: it was renamed, or "
                "stands in the place of another"
                for file in found.files
                if file.seal.opening is not None
                and not file.seal.is_copy
                and file.path.name.removesuffix(SUFFIX) != file.seal.opening.file
            ),
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
        "unproved": [],
        "notes": [],
    }


def summary_object(
    found: Sequence[VerifiedRecording], head: str, heads: KnownHeads
) -> dict[str, Any]:
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
    notes += _named_here(chain, sealed, heads)
    known = sum(heads.compare(file).listed for file in sealed)
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
        "file": "" if opening is None else opening.file,
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


def _named_here(chain: Chain, files: Sequence[SealedFile], heads: KnownHeads) -> Iterator[str]:
    """Yield what the lists in this user's state folder know about the files that are missing."""
    robots = {
        file.seal.opening.root: file.seal.opening.robot
        for file in files
        if file.seal.opening is not None
    }
    for root, number in chain.missing:
        name = heads.of_robot(robots[root]).named(root, number)
        if name:
            yield f"this machine's list of keys knows file {number}: it was {name}"
