"""clip, recover, convert: cut a recording, save a broken one, copy one into other files."""

from __future__ import annotations

import math
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from robotctl.base.errors import (
    IN_PARENTHESES,
    RecoveredWithLoss,
    Refused,
    UnreadableFile,
    UsageError,
)
from robotctl.cli.options import Json, new_app
from robotctl.cli.targets.driving import interrupted_by
from robotctl.cli.targets.recordings import (
    RecordedBy,
    RecordingsFolder,
    find_recording,
    parse_moment,
    recordings_folder,
    recordings_of,
)
from robotctl.cli.ui.output import print_answer, progress_bar
from robotctl.cli.ui.text import duration, moment, printable, short_path
from robotctl.kernel.constants import DAY_S, NS_PER_S
from robotctl.recording.format.names import CLIP_KINDS, Compression, EventKind

if TYPE_CHECKING:
    from robotctl.recording.keep.clip import Clip, Moment
    from robotctl.recording.keep.listing import ListedRecording


app = new_app()


*_KINDS, _LAST_KIND = CLIP_KINDS
_ALLOWED_KINDS = f"{', '.join(_KINDS)} or {_LAST_KIND}"


def _event_kind(text: str) -> EventKind:
    for kind in CLIP_KINDS:
        if kind.value == text:
            return kind
    raise UsageError(f"--event {text}", f"use {_ALLOWED_KINDS}")


@app.command()
def clip(
    file: Annotated[
        str | None,
        typer.Argument(
            metavar="[FILE]",
            help="An MCAP file, a recording's folder or name, or `last` [default: the newest "
            "with such an event].",
        ),
    ] = None,
    event: Annotated[
        EventKind | None,
        typer.Option(
            metavar="KIND",
            parser=_event_kind,
            help=f"The last {_ALLOWED_KINDS} [default: any of them].",
        ),
    ] = None,
    at: Annotated[
        str | None,
        typer.Option(
            metavar="T", help="A time instead: seconds into the recording, 12:03:04, or a date."
        ),
    ] = None,
    before: Annotated[float, typer.Option(metavar="S", help="Seconds before the event.")] = 30.0,
    after: Annotated[float, typer.Option(metavar="S", help="Seconds after the event.")] = 5.0,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="OUT",
            help="What to write [default: in RECORDING/clips; of a URL, here].",
        ),
    ] = None,
    folder: RecordingsFolder = None,
    robot: RecordedBy = None,
    as_json: Json = False,
) -> None:
    """Cut the part of a recording around an event into its own file.

    Works on any recording, also the current one. The clip is a complete recording, for example
    for replay --check: it begins with the latched messages and a snapshot of the journal.

    \b
    Examples:
      robotctl clip
      robotctl clip --event estop --before 30 --after 5
      robotctl clip last --at 12:03:04 -o incident.mcap
      robotctl clip s3://bucket/robots/robot_20260101_120000 --event estop
    """
    from robotctl.recording.keep.clip import ClipJob, make_clip, remaining_s

    if event is not None and at is not None:
        raise UsageError("--event and --at", "give one of them")
    for option, seconds in (("--before", before), ("--after", after)):
        if not (math.isfinite(seconds) and 0 <= seconds <= DAY_S):
            raise UsageError(f"{option} {seconds:g}", f"give seconds from 0 to {DAY_S:g}")
    source, about = _find(file, event, at, robot, folder)
    job = ClipJob(source.path, about, before, after, output)
    wait_s = remaining_s(job, source)
    if wait_s > 1.0 and not as_json:
        print(f"robotctl: waiting {wait_s:.0f} s for the end of the clip", file=sys.stderr)
    with progress_bar("cutting", quiet=as_json) as on_progress:
        made = make_clip(job, on_progress)
    lost = _loss("the recording could not be read completely", made.lost)
    print_answer(_as_object(source.path, made), _lines(made), as_json=as_json, error=lost)


def _loss(text: str, lost: Sequence[str]) -> RecoveredWithLoss | None:
    """Return an error with `text` and the sentences `lost`, None if `lost` is empty."""
    return RecoveredWithLoss(f"{text}: {'; '.join(lost)}") if lost else None


def _find(
    file: str | None,
    event: EventKind | None,
    at: str | None,
    robot: str | None,
    folder: Path | None,
) -> tuple[ListedRecording, Moment]:
    """Return the recording to clip, and the moment: `at`, or the last `event` in that recording.

    Raises:
        Refused: No recording contains such a moment.
        UnreadableFile: The recording `file` cannot be read.
    """
    from robotctl.recording.keep.listing import list_recording
    from robotctl.recording.read.files import recording_files

    if file is None:
        candidates = recordings_of(robot, recordings_folder(robot, folder))
        if not candidates:
            find_recording("last", robot, folder)  # raises Refused
    else:
        candidates = [find_recording(file, robot, folder, also_url=True)]
    for path in candidates:
        try:
            listed = list_recording(path)
        except OSError as error:
            if file is not None:
                recording_files(path)  # raises an error with the reason, if it finds one
                raise UnreadableFile(f"{path} cannot be read: {error.strerror}") from error
            continue
        found = _moment(listed, event, at)
        if found is not None:
            return listed, found
    if at is not None:
        where = "no recording holds" if file is None else f"{candidates[0]} does not hold"
        raise Refused(f"{where} the time {at}", "see: robotctl recordings", sentence=IN_PARENTHESES)
    what = "no emergency stop, error or mark" if event is None else f"no event {event.value!r}"
    where = "any recording" if file is None else str(candidates[0])
    raise Refused(
        f"there is {what} in {where}", "for any other time, use --at", sentence=IN_PARENTHESES
    )


def _moment(listed: ListedRecording, event: EventKind | None, at: str | None) -> Moment | None:
    from robotctl.recording.keep.clip import Moment

    if at is not None:
        at_ns = parse_moment(at, listed.start_ns, listed.end_ns)
        held = listed.start_ns <= at_ns <= listed.end_ns
        return Moment(at_ns) if held else None
    wanted = CLIP_KINDS if event is None else (event,)
    events = [each for each in listed.events if each.kind in wanted]
    return Moment.of(max(events, key=lambda each: each.log_ns)) if events else None


def _as_object(source: Path, made: Clip) -> dict[str, Any]:
    about = made.moment
    return {
        "source": str(source),
        "target": str(made.target),
        "event": None if about.kind is None else about.kind.value,
        "event_ns": about.log_ns,
        "text": about.text,
        "start_ns": made.start_ns,
        "end_ns": made.end_ns,
        "messages": made.message_count,
        "lost": list(made.lost),
    }


def _lines(made: Clip) -> list[str]:
    about, length_s = made.moment, (made.end_ns - made.start_ns) / NS_PER_S
    what = "" if about.kind is None else f"{about.kind.value}: {printable(about.text)}, "
    return [
        short_path(made.target),
        f"  around     {what}{moment(about.log_ns)}",
        f"  holds      {made.message_count} messages in {duration(length_s)}",
    ]


@app.command()
def recover(
    file: Annotated[
        str, typer.Argument(metavar="FILE", help="An MCAP file, or a recording's folder or name.")
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="OUT", help="What to write [default: FILE_recovered]."
        ),
    ] = None,
    folder: RecordingsFolder = None,
    robot: RecordedBy = None,
    as_json: Json = False,
) -> None:
    """Save what can be read of a broken recording into a new one.

    Reads MCAP files of any program, and overwrites nothing. The exit code is 0 if nothing is lost,
    8 if something is lost, and 6 if nothing can be read.

    \b
    Examples:
      robotctl recover broken.mcap
      robotctl recover recordings/robot_20260101_120000 -o saved
    """
    from robotctl.recording.keep.recover import recover as recover_file
    from robotctl.recording.keep.recover import recover_folder

    source = find_recording(file, robot, folder)
    target = output or _beside(source)
    with progress_bar("recovering", quiet=as_json) as on_progress:
        work = recover_folder if source.is_dir() else recover_file
        salvage = work(source, target, on_progress=on_progress)
    answer = {
        "source": str(source),
        "target": str(salvage.target),
        "messages": salvage.message_count,
        "attachments": salvage.attachment_count,
        "lost": list(salvage.lost),
    }
    what = f"{salvage.message_count} messages"
    if salvage.attachment_count:
        what += f" and {salvage.attachment_count} attachments"
    rest = "" if salvage.lost else ", nothing lost"
    line = f"{short_path(salvage.target)}: {what} saved{rest}"
    lost = _loss(f"{source} could not be saved completely", salvage.lost)
    print_answer(answer, [line], as_json=as_json, error=lost)


def _beside(source: Path) -> Path:
    """Return the default target: next to the source, but outside a rosbag2 folder."""
    folder = source.parent
    if (folder / "metadata.yaml").exists():
        folder = folder.parent  # inside, a reader would treat the copy as a part of the bag
    plain = Path(source.name.removesuffix(".zstd"))  # the copy is no .zstd file
    return folder / f"{plain.stem}_recovered{plain.suffix}"


@app.command()
def convert(
    source: Annotated[
        str,
        typer.Argument(
            metavar="FILE", help="A recording or a bag, in MCAP or sqlite3: folder, file or name."
        ),
    ],
    target: Annotated[
        Path, typer.Argument(metavar="OUT", help="A new folder, or a new file OUT.mcap.")
    ],
    compression: Annotated[
        Compression, typer.Option(help="How the messages are stored.")
    ] = Compression.ZSTD,
    split_mb: Annotated[
        int | None,
        typer.Option(metavar="MB", min=1, help="Begin a new file when one has this size."),
    ] = None,
    one_file: Annotated[bool, typer.Option("--one-file", help="Join all files in one.")] = False,
    folder: RecordingsFolder = None,
    robot: RecordedBy = None,
    as_json: Json = False,
) -> None:
    """Copy a recording into other files: joined, split, compressed.

    A bag of rosbag2 in sqlite3 becomes MCAP. Each message stays as it is, byte for byte, and so do
    metadata and attachments. The new files have no seal: that of the original does not hold for
    them. The exit code is 8 if something could not be read.

    \b
    Examples:
      robotctl convert last copy --one-file
      robotctl convert old_bag new_bag --split-mb 100 --compression lz4
      robotctl convert rosbag2_2024_01_01.db3 bag.mcap
    """
    from robotctl.recording.convert import MCAP_SUFFIX, Form, convert

    if split_mb is not None and (one_file or target.suffix == MCAP_SUFFIX):
        raise UsageError("--split-mb makes several files", "give a folder without --one-file")
    path = find_recording(source, robot, folder)
    is_one = one_file or target.suffix == MCAP_SUFFIX
    form = Form(compression, None if split_mb is None else split_mb * 1_000_000, is_one)
    with (
        interrupted_by((signal.SIGTERM, signal.SIGHUP)),
        progress_bar("converting", quiet=as_json) as on_progress,
    ):
        done = convert(path, target, form, on_progress)
    if done.is_live:
        note = f"{path} is still being recorded: the copy ends here"
        print(f"robotctl: {printable(note)}", file=sys.stderr)
    answer = {
        "source": str(path),
        "target": str(target),
        "files": [file.name for file in done.files],
        "messages": done.message_count,
        "attachments": done.attachment_count,
        "live": done.is_live,
        "lost": list(done.lost),
    }
    files = "1 file" if len(done.files) == 1 else f"{len(done.files)} files"
    line = f"{short_path(target)}: {done.message_count} messages in {files}"
    lost = _loss(f"{path} could not be converted completely", done.lost)
    print_answer(answer, [line], as_json=as_json, error=lost)
