"""recover: copy the readable part of a broken recording into a new one."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from robotctl.base.errors import RecoveredWithLoss
from robotctl.cli.options import Json, new_app
from robotctl.cli.targets.recordings import RecordedBy, RecordingsFolder, find_recording
from robotctl.cli.ui.output import print_answer, progress_bar
from robotctl.cli.ui.text import short_path

if TYPE_CHECKING:
    from robotctl.recording.keep.recover import RecoveryReport

app = new_app()


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
    error = None
    if salvage.lost:
        error = RecoveredWithLoss(
            f"{source} could not be saved completely: {'; '.join(salvage.lost)}"
        )
    print_answer(_as_object(source, salvage), _lines(salvage), as_json=as_json, error=error)


def _beside(source: Path) -> Path:
    """Return the default target: next to the source, but outside a rosbag2 folder.

    Inside that folder, a reader would treat the copy as a part of the bag.
    """
    folder = source.parent
    if (folder / "metadata.yaml").exists():
        folder = folder.parent
    plain = Path(source.name.removesuffix(".zstd"))  # the copy is no .zstd file
    return folder / f"{plain.stem}_recovered{plain.suffix}"


def _as_object(source: Path, salvage: RecoveryReport) -> dict[str, Any]:
    return {
        "source": str(source),
        "target": str(salvage.target),
        "messages": salvage.message_count,
        "attachments": salvage.attachment_count,
        "lost": list(salvage.lost),
    }


def _lines(salvage: RecoveryReport) -> Iterator[str]:
    what = f"{salvage.message_count} messages"
    if salvage.attachment_count:
        what += f" and {salvage.attachment_count} attachments"
    rest = "" if salvage.lost else ", nothing lost"
    yield f"{short_path(salvage.target)}: {what} saved{rest}"
