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


IMPORTS_OF_A_FOLDER = """
from pathlib import Path
from robotctl.cli.commands.replay.select_recordings import select_recordings
from robotctl.collection.catalogue import _stamps
from robotctl.recording.keep.listing import list_recordings
"""

LISTED = """
folder = Path({folder!r})
print([path.name for path in select_recordings([folder], None)[0]])
print([path.name for path in select_recordings(sorted(folder.iterdir()), None)[0]])
print([(each.path.name, each.readable, each.damage) for each in list_recordings(folder)])
print(_stamps(folder, {{}})[1])
"""


@as_root
def test_a_recording_that_may_not_be_listed_is_not_left_out_in_silence() -> None:
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        folder.chmod(0o755)
        (folder / "closed").mkdir(0o700)
        (folder / "closed" / "robot_0.mcap").touch()
        (folder / "notes").mkdir(0o755)
        code = LISTED.format(folder=made)
        process = process_of(MEMBER, [100], IMPORTS_OF_A_FOLDER, code, os.environ)
        out, err = process.communicate(timeout=DEADLINE_S)
    why = "Permission denied (run this as its owner, or record with recording.group_readable: true)"
    assert out.splitlines() == [
        "['closed']",
        "['closed']",
        f"[('closed', False, ('{why}',))]",
        "['closed is left out: this user may not read it']",
    ], err
