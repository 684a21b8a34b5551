"""Recordings are private to their owner, with any umask; one option shares them with the group."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest
from PIL import Image

from robotctl.config import Config, with_setting
from robotctl.daemon.recording.recordings_folder import open_recorder
from robotctl.recording import Recorder
from robotctl.recording.keep.clip import Moment
from robotctl.recording.keep.clip_job import ClipJob, make_clip
from robotctl.recording.keep.listing import set_kept
from robotctl.recording.keep.recover import recover, recover_folder
from robotctl.recording.keep.repair import repair
from robotctl.show.figure import path_figure
from robotctl.show.png import write_path_png
from robotctl.testing.drives import START_NS, TWIST
from tests.support.recordings import foreign, write_numbered

PRIVATE = {"file": 0o600, "folder": 0o700}
SHARED = {"file": 0o640, "folder": 0o750}


@pytest.fixture(params=[0o000, 0o022, 0o077, 0o177], ids=oct)
def umask(request: pytest.FixtureRequest) -> Iterator[int]:
    before = os.umask(request.param)
    yield request.param
    os.umask(before)


def begin(recordings: Path, *, shared: bool) -> Recorder:
    config = with_setting(Config(), "recording.group_readable", shared)
    silent = [lambda told: None] * 3
    return open_recorder(recordings, "robot", config, lambda: "IDLE", *silent)


def modes(folder: Path) -> dict[Path, int]:
    """Return the mode of each file and folder, including the folder itself."""
    return {path: stat.S_IMODE(path.stat().st_mode) for path in (folder, *folder.rglob("*"))}


def expected(folder: Path, wanted: dict[str, int]) -> dict[Path, int]:
    return {
        path: wanted["folder" if path.is_dir() else "file"] for path in (folder, *folder.rglob("*"))
    }


@pytest.mark.usefixtures("umask")
@pytest.mark.parametrize(("shared", "wanted"), [(False, PRIVATE), (True, SHARED)])
def test_whatever_is_recorded_and_made_of_it_has_the_same_readers(
    tmp_path: Path, shared: bool, wanted: dict[str, int]
) -> None:
    recordings = tmp_path / "a" / "recordings"
    recorder = begin(recordings, shared=shared)
    write_numbered(recorder, recorder.add_topic(TWIST), range(1, 101))
    recorder.split()
    write_numbered(recorder, recorder.add_topic(TWIST), range(101, 201))
    file = recorder.close().file
    recording = file.parent
    assert file.name.endswith("_1.mcap")
    set_kept(recording, True)
    moment = Moment(START_NS + 50_000_000, None, "here")
    make_clip(ClipJob(recording, moment, 0.01, 0.01))
    elsewhere = tmp_path / "a" / "elsewhere.mcap"
    make_clip(ClipJob(recording, moment, 0.01, 0.01, elsewhere))
    os.truncate(file, file.stat().st_size - 20)
    recover(file, tmp_path / "a" / "recovered.mcap")
    recover_folder(recording, tmp_path / "a" / "recovered")
    assert [*repair(recordings)]
    write_path_png(
        recording / "path.png", path_figure([(0.0, 0.0), (1.0, 1.0)], [(0.0, 0.0)], "path")
    )
    with Image.open(recording / "path.png") as picture:
        assert picture.size == (800, 800)
    made = modes(tmp_path / "a")
    assert len(made) == 16
    assert made == expected(tmp_path / "a", wanted)


def test_what_is_recovered_of_a_file_that_all_may_read_is_private(tmp_path: Path) -> None:
    source = foreign(tmp_path / "theirs.mcap", 100)
    source.chmod(0o644)
    recover(source, tmp_path / "ours.mcap")
    assert stat.S_IMODE((tmp_path / "ours.mcap").stat().st_mode) == 0o600


def test_a_folder_that_is_there_keeps_its_mode(tmp_path: Path) -> None:
    (tmp_path / "recordings").mkdir()
    (tmp_path / "recordings").chmod(0o2755)
    begin(tmp_path / "recordings", shared=False).close()
    assert stat.S_IMODE((tmp_path / "recordings").stat().st_mode) == 0o2755


@pytest.mark.parametrize("shared", [False, True])
def test_recordings_keep_the_group_of_a_folder_that_hands_it_down(
    tmp_path: Path, shared: bool
) -> None:
    (tmp_path / "recordings").mkdir()
    (tmp_path / "recordings").chmod(0o2750)
    recording = begin(tmp_path / "recordings", shared=shared).close().file.parent
    assert stat.S_IMODE(recording.stat().st_mode) == (0o2750 if shared else 0o2700)


def test_a_file_system_without_permissions_is_recorded_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "fchmod", refuse)
    monkeypatch.setattr(Path, "chmod", refuse)
    recorder = begin(tmp_path / "recordings", shared=True)
    write_numbered(recorder, recorder.add_topic(TWIST), range(1, 11))
    assert recorder.close().written == 10
