"""Recovers a recording of several files."""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from itertools import accumulate
from pathlib import Path
from shutil import rmtree

from robotctl.errors import Refused, UnreadableFile
from robotctl.recording.disk.access import is_shared, make_folder
from robotctl.recording.format.rosbag2 import metadata_text, total_count_in
from robotctl.recording.keep.bag_metadata import rewrite_metadata
from robotctl.recording.keep.recover import Progress, RecoveryReport, recover
from robotctl.recording.read.files import absent_files, recording_files
from robotctl.recording.read.zstd_file import SUFFIX


def recover_folder(
    source: Path, target: Path, *, on_progress: Progress = lambda done, total: None
) -> RecoveryReport:
    """Write all that can be read of the recording `source` into the new folder `target`.

    Raises:
        UnreadableFile: Nothing can be read.
        Refused: `target` exists or cannot be written.

    After an error no new folder remains.
    """
    text = metadata_text(source)
    paths = recording_files(source)
    sizes = [2 * path.stat().st_size if path.exists() else 0 for path in paths]
    try:
        make_folder(target, shared=is_shared(source))
    except OSError as error:
        raise Refused(f"cannot write {target}: {error.strerror}") from error
    lost = absent_files(text, paths)
    saved: list[RecoveryReport] = []
    try:
        for path, before in zip(paths, accumulate(sizes[:-1], initial=0), strict=True):
            tell = partial(_tell, on_progress, before, sum(sizes))
            try:
                report = recover(path, target / path.name.removesuffix(SUFFIX), on_progress=tell)
            except UnreadableFile as error:
                lost.append(str(error))
            else:
                saved.append(report)
                lost += (f"{path.name}: {sentence}" for sentence in report.lost)
        told, count = total_count_in(text), sum(report.message_count for report in saved)
        if not lost and told > count:
            lost.append(f"metadata.yaml counts {told} messages, and {count} are there")
        if not saved:
            raise UnreadableFile("; ".join(lost))
        rewrite_metadata(target, [report.target for report in saved])
    except BaseException as error:
        with suppress(OSError):
            rmtree(target)
        if isinstance(error, OSError):
            raise Refused(f"cannot write {target}: {error.strerror}") from error
        raise
    return RecoveryReport(
        target,
        count,
        sum(report.attachment_count for report in saved),
        tuple(lost),
    )


def _tell(on_progress: Progress, before: int, total: int, done: int, _: int) -> None:
    on_progress(before + done, total)
