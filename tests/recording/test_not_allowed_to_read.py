"""Another user is told why a recording cannot be read, and what opens it to a group."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import pytest

from tests.support.users import as_root, process_of
from tests.support.waiting import DEADLINE_S

MEMBER = 65502

IMPORTS = """
from pathlib import Path
from robotctl.errors import UnreadableFile
from robotctl.recording.read.reader import read_info
from robotctl.recording.read.whole_file import read_whole_file
"""

READ = """
for read, path in ((read_info, {folder!r}), (read_info, {file!r}), (read_whole_file, {file!r})):
    try:
        read(Path(path))
    except UnreadableFile as error:
        print(error)
"""


@as_root
@pytest.mark.parametrize("closed", ["folder", "file"])
def test_who_may_not_read_a_recording_is_told_the_cure(closed: str) -> None:
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        folder.chmod(0o700 if closed == "folder" else 0o755)
        file = folder / "robot_0.mcap"
        file.touch(mode=0o600)
        code = READ.format(folder=str(folder), file=str(file))
        process = process_of(MEMBER, [100], IMPORTS, code, os.environ)
        out, err = process.communicate(timeout=DEADLINE_S)
    why = "Permission denied (run this as its owner, or record with recording.group_readable: true)"
    inside = "robot_0.mcap: " if closed == "file" else ""
    assert out.splitlines() == [
        f"{folder} cannot be read: {inside}{why}",
        f"{file} cannot be read: {why}",
        f"{file} cannot be read: {why}",
    ], err
