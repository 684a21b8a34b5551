"""Making whole what a killed process or a power cut has left of our own recordings."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from robotctl.errors import RobotctlError
from robotctl.recording.bag_metadata import rewrite_metadata
from robotctl.recording.catalog import CatalogFolder, own_recordings
from robotctl.recording.file_index import FileIndex
from robotctl.recording.identity import LEDGER_RECORD, RECOVERY_RECORD
from robotctl.recording.mcap_file import McapFile
from robotctl.recording.mcap_input import Damaged, InputFile, walk_records
from robotctl.recording.recover import recover
from robotctl.recording.storage import DiskFile
from robotctl.recording.summary import index_from_summary, read_written_file

_UNFINISHED = ".repair"


def repair(recordings: Path) -> list[str]:
    """Repair the recordings below `recordings` that nobody is writing.

    A file that is whole but was never closed is marked as checked, so that it is read once only;
    a torn one is replaced by what can be read of it. Returns a sentence for each. Blocks: it
    reads the whole of each such file. Raises OSError if `recordings` cannot be listed.
    """
    done: list[str] = []
    for folder in own_recordings(recordings):
        if not folder.live:
            with suppress(OSError):  # the next start tries again
                done += _repair_folder(folder)
    return done


def _repair_folder(folder: CatalogFolder) -> list[str]:
    for leftover in folder.path.glob(f"*{_UNFINISHED}"):
        leftover.unlink()
    done = [sentence for file in folder.files if (sentence := _repair_file(file.path))]
    if done:
        rewrite_metadata(folder.path, [file.path for file in folder.files])
    return done


def _repair_file(path: Path) -> str:
    """What was done to the file; "" if it was closed properly."""
    with InputFile(path) as file:
        try:
            index = index_from_summary(file)
            if index.has_metadata(LEDGER_RECORD, RECOVERY_RECORD):
                return ""
            _verify(file, index)
        except Damaged:
            return _replace(path)
        written = read_written_file(file)
    storage = DiskFile(path, new=False)
    try:
        mcap = McapFile.resume(storage, written)
        mcap.add_metadata(RECOVERY_RECORD, {"lost": ""})
        mcap.commit()
        mcap.sync()
    finally:
        storage.close()
    return f"{path.name} was not closed: its {index.message_count} messages are whole"


def _verify(file: InputFile, index: FileIndex) -> None:
    """Read everything once. Raises Damaged."""
    for place in index.places:
        for _ in walk_records(place.read(file)):
            pass


def _replace(path: Path) -> str:
    repaired = path.with_name(path.name + _UNFINISHED)
    try:
        salvage = recover(path, repaired)
    except RobotctlError as error:
        return f"{path.name} was torn and cannot be repaired: {error}"
    repaired.replace(path)
    lost = "; ".join(salvage.lost)
    return f"{path.name} was torn: {salvage.message_count} messages are whole ({lost})"
