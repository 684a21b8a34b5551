"""recover: what can be saved of a broken recording."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from robotctl.cli.options import Json, new_app
from robotctl.cli.support.answer import tell
from robotctl.cli.support.recording_paths import RecordedBy, Recordings, find_recording
from robotctl.cli.terminal.progress import progress_bar
from robotctl.cli.terminal.text import short_path
from robotctl.errors import RecoveredWithLoss

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
    folder: Recordings = None,
    robot: RecordedBy = None,
    as_json: Json = False,
) -> None:
    """Save what can be read of a broken recording into a new one.

    Of any writer. Nothing is overwritten. Exits with 0 where nothing is lost, 8 where something
    is, and 6 where nothing can be read.

    \b
    Examples:
      robotctl recover broken.mcap
      robotctl recover recordings/robot_20260101_120000 -o saved
    """
    from robotctl.recording.keep.recover import recover as recover_file
    from robotctl.recording.keep.recover_folder import recover_folder

    source = find_recording(file, robot, folder)
    target = output or _beside(source)
    with progress_bar("recovering", quiet=as_json) as on_progress:
        work = recover_folder if source.is_dir() else recover_file
        salvage = work(source, target, on_progress=on_progress)
    error = None
    if salvage.lost:
        error = RecoveredWithLoss(f"not all of {source} could be saved: {'; '.join(salvage.lost)}")
    tell(_as_object(source, salvage), _lines(salvage), as_json=as_json, error=error)


def _beside(source: Path) -> Path:
    """Where to save to: never into the folder of a bag, where it would be taken for a part."""
    folder = source.parent
    if (folder / "metadata.yaml").exists():
        folder = folder.parent
    plain = Path(source.name.removesuffix(".zstd"))  # a copy is not compressed as a whole
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
    rest = "" if salvage.lost else ", nothing is lost"
    yield f"{short_path(salvage.target)}: {what} are saved{rest}"
