"""convert: a recording as new files, every message as it was."""

from __future__ import annotations

from pathlib import Path

from robotctl.errors import UnreadableFile
from robotctl.recording.convert.converter import Converted, Converter, Form
from robotctl.recording.convert.sources import Progress, Sources
from robotctl.recording.disk.atomic_output import atomic_output
from robotctl.recording.read.file_index import note_missing

MCAP_SUFFIX = ".mcap"


def convert(
    source: Path, target: Path, form: Form, on_progress: Progress = lambda done, total: None
) -> Converted:
    """Write the recording `source` into the new folder `target`, or a file if it ends in .mcap.

    Raises:
        UnreadableFile: Nothing can be read.
        Refused: `target` exists or cannot be written; nothing new remains.
    """
    sources = Sources(source, on_progress)
    with atomic_output(target, source) as unfinished:
        if target.suffix == MCAP_SUFFIX:
            converter = Converter(lambda number: unfinished, form)
        else:
            unfinished.mkdir()
            converter = Converter(
                lambda number: unfinished / f"{target.name}_{number}{MCAP_SUFFIX}", form
            )
        done = converter.run(sources)
        lost = [*sources.lost, *done.lost]
        if not lost and sources.told_messages > done.message_count:
            note_missing(
                lost,
                f"metadata.yaml counts {sources.told_messages} messages, "
                f"and {done.message_count} are there",
            )
        if not done.message_count and lost:
            raise UnreadableFile(f"{source} holds no readable message: {'; '.join(lost)}")
        if unfinished.is_dir():
            converter.write_list(unfinished)
    done.lost, done.is_live = lost, sources.is_live
    return done
