"""Which files of a folder are one recording."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from robotctl.base.errors import UnreadableFile
from robotctl.recording import Recording
from robotctl.recording.format.journal import decode
from robotctl.recording.format.names import INFO_RECORD
from robotctl.recording.read.files import recording_files
from robotctl.recording.read.journal_reader import journal_topic


class FileGroup(NamedTuple):
    """The files of one recording in order, and the name of its robot ("" if not recorded)."""

    robot: str
    files: list[Path]


def file_groups(path: Path) -> list[FileGroup]:
    """Return the files of `path` grouped by recording; the group named like `path` comes first.

    A file joins a group of the same robot if it has no journal, or if its first journal entry has a
    higher `seq` than the first entries of the group's files. Unreadable files join the first group,
    whose check reports why they cannot be read.

    Raises:
        UnreadableFile: `path` is not a recording.
    """
    files = recording_files(path)
    if len(files) < 2:
        return [FileGroup("", files)]
    groups: list[FileGroup] = []
    newest: list[int] = []
    loose: list[Path] = []
    for file in files:
        try:
            robot, first = _identity(file)
        except UnreadableFile:
            loose.append(file)
            continue
        for number, group in enumerate(groups):
            if group.robot == robot and (first is None or first > newest[number]):
                group.files.append(file)
                newest[number] = newest[number] if first is None else first
                break
        else:
            groups.append(FileGroup(robot, [file]))
            newest.append(-1 if first is None else first)
    groups.sort(key=lambda group: not any(each.name.startswith(path.name) for each in group.files))
    if not groups:
        return [FileGroup("", files)]
    first_group = groups[0]
    together = [file for file in files if file in first_group.files or file in loose]
    return [FileGroup(first_group.robot, together), *groups[1:]]


def _identity(file: Path) -> tuple[str, int | None]:
    """Return the robot of a file and the `seq` of its first journal entry, None if it has none."""
    with Recording(file) as recording:
        info = recording.info()
        topic = journal_topic(info)
        robot = info.metadata.get(INFO_RECORD, {}).get("robot", "")
        if topic is None:
            return robot, None
        messages = recording.in_order_written({topic}, lambda sentence: None)
        entry = next((decode(message.data) for message in messages), None)
        return robot, None if entry is None else entry.seq
