"""verify, key: check the seals of recordings, and show or change the keys that sign them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from robotctl.base.errors import (
    Divergence,
    NotSealed,
    Refused,
    RobotctlError,
    UnreadableFile,
    UsageError,
)
from robotctl.base.paths import DEFAULT_ROBOT, chain_to, seal_folder
from robotctl.cli.options import Json, Robot, new_app, new_group
from robotctl.cli.targets.recordings import RecordedBy, file_path, select_recordings
from robotctl.cli.ui.output import print_answer, progress_bar
from robotctl.cli.ui.text import moment, printable, row, short_path, size

if TYPE_CHECKING:
    from robotctl.recording.read.whole_file import SealOfRead, WholeFile
    from robotctl.recording.read.whole_recording import VerifiedRecording
    from robotctl.recording.seal import KnownHeads, StoredKey


app = new_app()

_DIGEST_DIGITS = 64


@app.command()
def verify(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE",
            parser=file_path,
            help="An MCAP file, a recording's folder or name, a folder of them, a URL, last.",
        ),
    ],
    head: Annotated[
        str,
        typer.Option(metavar="HEX", help="A head that is known: it must be in what is verified."),
    ] = "",
    source: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            parser=file_path,
            help="The recording that a clip was cut from: all that it took from there is compared.",
        ),
    ] = None,
    robot: RecordedBy = None,
    as_json: Json = False,
) -> None:
    """Show whether recordings are whole and sealed. Reads every byte; needs no ROS.

    The exit code is 0 if all are whole and sealed, 4 if one is whole but not sealed, 6 if one
    cannot be read, and 7 if a byte, the chain or a signature is wrong, or if the file contradicts
    the keys and ends of files that this machine has noted.

    \b
    Examples:
      robotctl verify last
      robotctl verify recordings
      robotctl verify s3://bucket/robots/run.mcap
      robotctl verify robot_0.mcap --head $(ssh robot robotctl key head)
      robotctl verify stop.mcap --source recordings/robot_20260101_120000
    """
    if source is not None:
        if len(files) != 1 or head:
            raise UsageError("--source takes one clip, and no --head")
        verify_clip(files[0], source, as_json=as_json)
        return
    if head and not (len(head) == _DIGEST_DIGITS and set(head.lower()) <= set("0123456789abcdef")):
        raise UsageError(
            f"--head {head[:80]} is no head", "give 64 digits, as robotctl key head does"
        )
    paths, _ = select_recordings(files, robot, also_urls=True)
    answer = verify_together(paths, head, quiet=as_json)
    lines = [line for report in answer["recordings"] for line in recording_lines(report)]
    lines += summary_lines(answer)
    print_answer(answer, lines, as_json=as_json, error=_gravest(answer))


def _gravest(answer: dict[str, Any]) -> RobotctlError | None:
    reports = answer["recordings"]

    def those(verdict: str, what: str) -> str:
        count = sum(report["verdict"] == verdict for report in reports)
        if len(reports) == 1:
            return f"the recording {what}"
        return f"{count} of {len(reports)} recordings: {what}"

    verdicts = {report["verdict"] for report in reports}
    if "broken" in verdicts:
        return Divergence(those("broken", "is not as it was written"))
    if answer["wrong"]:
        return Divergence(f"the chain is broken: {answer['wrong'][0]}")
    if "unreadable" in verdicts:
        return UnreadableFile(those("unreadable", "could not be read completely"))
    if "whole" in verdicts:
        return NotSealed(those("whole", "is whole, but not sealed"))
    return None


def verify_clip(clip: Path, source: Path, *, as_json: bool) -> None:
    """Print whether a clip is an unchanged part of `source`, and which signatures cover it.

    Raises:
        Divergence: The clip or the source was changed, or the clip differs from the source.
        NotSealed: The clip is a part of the source, which is not sealed.
        UnreadableFile: The clip or the source cannot be read.
    """
    from robotctl.recording.keep.clip_origin import compare_with_source
    from robotctl.recording.read.whole_recording import verify_recording

    with progress_bar("reading", quiet=as_json) as on_progress:
        cut = verify_recording(clip)
        whole = verify_recording(source, on_progress)
        origin = compare_with_source(clip, source)
    wrong = [
        *(f"{clip.name}: {sentence}" for sentence in (*cut.flaws, *cut.unreadable)),
        *(f"{source.name}: {sentence}" for sentence in whole.flaws),
        *(f"{clip.name}: {sentence}" for sentence in origin.wrong),
    ]
    links = [
        each
        for file in whole.files
        if (each := _links(file, origin.start_ns, origin.end_ns)) is not None
    ]
    answer: dict[str, Any] = {
        "clip": str(clip),
        "source": str(source),
        "verdict": "broken" if wrong else whole.proof.value,
        "messages": origin.messages,
        "links": links,
        "wrong": wrong,
        "not_proved": origin.not_proved,
    }
    lines = [
        f"{answer['verdict']:12}{short_path(str(clip))}",
        *row(
            "            ",
            f"{origin.messages} messages"
            + ("" if wrong else ", their types and channels, and the metadata")
            + f" are those of {short_path(str(source))}",
        ),
        *(
            line
            for each in links
            for line in row(
                "            ",
                f"sealed by the links {each['first']} to {each['last']} of {each['file']}, "
                f"the last at {moment(each['to_ns'])}",
            )
        ),
        *(line for sentence in wrong for line in row("            ", f"wrong: {sentence}")),
        *(line for each in origin.not_proved for line in row("", f"not proved: {each}")),
    ]
    error: RobotctlError | None = None
    if wrong:
        error = Divergence(f"the clip is not proved: {wrong[0]}")
    elif whole.unreadable:
        error = UnreadableFile(f"{source} could not be read completely")
    elif answer["verdict"] == "whole":
        error = NotSealed("the clip is a part of its source, which is not sealed")
    print_answer(answer, lines, as_json=as_json, error=error)


def _links(file: WholeFile, start_ns: int, end_ns: int) -> dict[str, Any] | None:
    """Return the signed links of a file that cover `start_ns` to `end_ns`, None if none does."""
    after = [link for link in file.seal.links if link.time_ns >= start_ns]
    if not after or file.seal.links[0].time_ns > end_ns:
        return None
    # A link signs all bytes before it: the first at or after `end_ns` covers the end.
    behind = next((n for n, link in enumerate(after) if link.time_ns >= end_ns), len(after) - 1)
    links = after[: behind + 1]
    return {
        "file": file.path.name,
        "first": links[0].number,
        "last": links[-1].number,
        "from_ns": links[0].time_ns,
        "to_ns": links[-1].time_ns,
        "digest": links[-1].digest.hex(),
    }


def verify_together(paths: Sequence[Path], head: str = "", *, quiet: bool) -> dict[str, Any]:
    """Verify recordings and the chain of their files, and return the object for `--json`.

    `head` is the digest of a signed link that one of the recordings must contain, "" for none.
    """
    from robotctl.recording.read.whole_recording import Chain, VerifiedRecording, verify_recording
    from robotctl.recording.seal import known_heads

    found: list[VerifiedRecording] = []
    for path in paths:
        with progress_bar(f"reading {path.name}", quiet=quiet) as on_progress:
            try:
                found.append(verify_recording(path, on_progress))
            except UnreadableFile as error:
                found.append(VerifiedRecording(path, (), (str(error),), (), Chain()))
    heads = known_heads()
    objects = [_recording_object(each, heads) for each in found]
    return {"recordings": objects, **_summary_object(found, head, heads)}


_LABEL_WIDTH = 12
_INDENT = " " * _LABEL_WIDTH
_KEY_DIGITS = 16

NOT_PROVED = (
    "who could use the key: at that time, each reader of the robot's state folder could",
    "what was recorded before the first file here",
    "that nothing was cut off behind the last head: give a later one with --head",
)


def _recording_object(found: VerifiedRecording, heads: KnownHeads) -> dict[str, Any]:
    """Return one recording's object in `--json`; `heads` are those in this user's journals."""
    from robotctl.recording.read.files import SUFFIX
    from robotctl.recording.read.whole_recording import RecordingProof, compare_known

    known = [(file.path.name, compare_known(file, heads)) for file in found.files]
    wrong = [*found.wrong, *(f"{name}: {each.wrong}" for name, each in known if each.wrong)]
    unproved = [f"{name}: {each.unproved}" for name, each in known if each.unproved]
    return {
        "path": str(found.path),
        "verdict": (RecordingProof.BROKEN if wrong else found.proof).value,
        "files": [_file_object(file) for file in found.files],
        "wrong": wrong,
        "unreadable": list(found.unreadable),
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
                for file in found.files
                if file.loose
            ),
            *(f"{file.path.name}: {note}" for file in found.files for note in file.seal.notes),
            *found.chain.absent,
        ],
    }


def _summary_object(
    found: Sequence[VerifiedRecording], head: str, heads: KnownHeads
) -> dict[str, Any]:
    """Return the summary of all recordings: their chain, the head, and the limits of the proof."""
    from robotctl.recording.read.whole_file import SealState
    from robotctl.recording.read.whole_recording import check_chain, find_head

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
    for root, number in chain.missing:
        if name := heads.named(root, number):
            notes.append(f"this machine's list of keys knows file {number}: it was {name}")
    openings = [file.seal.opening for file in sealed if file.seal.opening is not None]
    known = sum(heads.opened.get(opening.key) == opening for opening in openings)
    if known:
        notes.append(f"this machine's list of keys knows {known} of {len(sealed)} files")
    return {
        "wrong": wrong,
        "notes": notes,
        "not_proved": list(NOT_PROVED[: 2 if head else 3]) if sealed else [],
    }


def recording_lines(report: dict[str, Any]) -> Iterator[str]:
    """Yield the lines to print for one recording; `report` is its object in `--json`."""
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
    """Yield the lines about all recordings together: errors, notes, and what is not proved."""
    for name, label in (("wrong", "wrong"), ("notes", "note"), ("not_proved", "not proved")):
        for sentence in summary[name]:
            yield from row("", f"{label}: {sentence}")


def _file_object(file: WholeFile) -> dict[str, Any]:
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
        "seal": _seal_object(file.seal),
    }


def _seal_object(seal: SealOfRead) -> dict[str, Any]:
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


group = new_group(app, "key")


@group.callback()
def key() -> None:
    """Show or change the keys that seal the recordings of a robot.

    \b
    Examples:
      robotctl key show
      robotctl key head
      robotctl key rotate
    """


@group.command()
def show(robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Show the robot's first key, the present one, and the newest head. Shows no secret.

    \b
    Examples:
      robotctl key show
      robotctl key show --json | jq -r .root
    """
    stored = _stored(robot)
    print_answer(_as_object(robot, stored), _lines(robot, stored), as_json=as_json)


@group.command()
def head(robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Show the newest head of the chain: keep it elsewhere, and give it to verify --head.

    It is that of the last stored link, which is at most 10 seconds old while recording.

    \b
    Examples:
      robotctl key head
      robotctl verify recordings --head $(robotctl key head)
    """
    stored = _stored(robot)
    if not stored.head.number:
        raise Refused("no recording is sealed yet", "start the robot")
    answer = _as_object(robot, stored)["head"]
    print_answer(answer, [stored.head.digest], as_json=as_json)


@group.command()
def rotate(robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Begin a new chain with a new key, from the next file on; the old key signs for it.

    Keys change with each file by themselves; rotate when others may have read the present one.

    \b
    Examples:
      robotctl key rotate
    """
    from robotctl.recording.seal import Keyring

    _stored(robot)  # a new robot gets its key when it starts
    try:
        stored = Keyring(seal_folder(robot), robot).rotate()
    except (OSError, ValueError) as error:
        raise Refused(f"the key cannot be changed: {error}", "see `robotctl key show`") from error
    print_answer(_as_object(robot, stored), _lines(robot, stored), as_json=as_json)


def _stored(robot: str) -> StoredKey:
    """Return the present key.

    Raises:
        Refused: The robot has no key, or the key cannot be read.
    """
    from robotctl.recording.seal import Keyring

    folder = seal_folder(robot)
    chain_to(folder).check()
    try:
        stored = Keyring(folder, robot).load()
    except (OSError, ValueError) as error:
        raise Refused(
            f"the key of {robot} cannot be read: {error}", "see docs/recordings.md"
        ) from (error)
    if stored is None:
        raise Refused(f"{robot} has no key yet in {folder}", "start the robot")
    return stored


def _as_object(robot: str, stored: StoredKey) -> dict[str, Any]:
    head = stored.head
    return {
        "robot": robot,
        "folder": str(seal_folder(robot)),
        "root": stored.root,
        "key": stored.key,
        "files": stored.files,
        "head": {
            "digest": head.digest,
            "file": head.file,
            "number": head.number,
            "covered": head.covered,
            "time_ns": head.time_ns,
            "closed": head.closed,
        },
    }


def _lines(robot: str, stored: StoredKey) -> list[str]:
    head = stored.head
    newest = [
        f"head         {head.digest}",
        f"             {moment(head.time_ns)}, {printable(head.file)}",
    ]
    return [
        f"first key    {stored.root}",
        f"present key  {stored.key}",
        f"folder       {short_path(seal_folder(robot))}",
        f"files        {stored.files}",
        *(newest if head.number else []),
    ]
