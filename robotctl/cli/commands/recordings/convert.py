"""convert: copy a recording into other files: joined, split, compressed, or from sqlite3."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from robotctl.base.errors import RecoveredWithLoss, UsageError
from robotctl.cli.options import Json, new_app
from robotctl.cli.targets.interrupts import interrupted_by
from robotctl.cli.targets.recordings import RecordedBy, RecordingsFolder, find_recording
from robotctl.cli.ui.output import print_answer, progress_bar
from robotctl.cli.ui.text import printable, short_path
from robotctl.recording.format.names import Compression

if TYPE_CHECKING:
    from robotctl.recording.convert import Converted

app = new_app()


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
    error = None
    if done.lost:
        error = RecoveredWithLoss(
            f"{path} could not be converted completely: {'; '.join(done.lost)}"
        )
    print_answer(_as_object(path, target, done), _lines(target, done), as_json=as_json, error=error)


def _as_object(source: Path, target: Path, done: Converted) -> dict[str, Any]:
    return {
        "source": str(source),
        "target": str(target),
        "files": [file.name for file in done.files],
        "messages": done.message_count,
        "attachments": done.attachment_count,
        "live": done.is_live,
        "lost": list(done.lost),
    }


def _lines(target: Path, done: Converted) -> Iterator[str]:
    files = "1 file" if len(done.files) == 1 else f"{len(done.files)} files"
    yield f"{short_path(target)}: {done.message_count} messages in {files}"
