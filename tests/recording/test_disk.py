"""A write to a file on disk is complete, or raises OSError.

A file beside a recording is replaced completely or not at all.
Recordings are private to their owner, with any umask; one option shares them with the group.
Another user is told why a recording cannot be read, and what opens it to a group.
"""

from __future__ import annotations

import errno
import os
import random
import stat
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from pathlib import Path

import pytest
from PIL import Image

from robotctl.config import Config, with_setting
from robotctl.daemon.recording.recordings_folder import open_recorder
from robotctl.recording import Recorder
from robotctl.recording.format.disk import MAX_PARTS, DiskFile, replaced_file
from robotctl.recording.keep.clip import ClipJob, Moment, make_clip
from robotctl.recording.keep.listing import set_kept
from robotctl.recording.keep.recover import recover, recover_folder
from robotctl.recording.keep.repair import repair
from robotctl.show.figure import path_figure
from robotctl.show.png import write_path_png
from robotctl.testing.drives import START_NS, TWIST
from tests.support.recordings import foreign, write_numbered
from tests.support.users import as_root, process_of
from tests.support.waiting import DEADLINE_S


def test_writes_that_the_kernel_cuts_short_are_completed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dice = random.Random(12)
    whole = os.pwritev

    def cut_short(fd: int, parts: Sequence[memoryview], offset: int) -> int:
        data = b"".join(parts)
        return whole(fd, [data[: dice.randint(1, len(data))]], offset)

    monkeypatch.setattr(os, "pwritev", cut_short)
    file = DiskFile(tmp_path / "file")
    parts = [dice.randbytes(dice.randint(0, 50)) for _ in range(300)]
    file.write_at([b"begin", *parts], 0)
    file.write_at([bytearray(b"BEG"), memoryview(b"IN")], 0)
    file.close()
    assert (tmp_path / "file").read_bytes() == b"BEGIN" + b"".join(parts)


def test_more_parts_than_the_kernel_takes_are_written(tmp_path: Path) -> None:
    file = DiskFile(tmp_path / "file")
    file.write_at([b"%06d" % number for number in range(3 * MAX_PARTS)], 10)
    file.close()
    expected = b"".join(b"%06d" % number for number in range(3 * MAX_PARTS))
    assert (tmp_path / "file").read_bytes() == bytes(10) + expected


def test_a_disk_that_takes_nothing_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "pwritev", lambda fd, parts, offset: 0)
    file = DiskFile(tmp_path / "file")
    with pytest.raises(OSError, match="Input/output error"):
        file.write_at([b"data"], 0)
    file.close()


def test_a_folder_that_cannot_be_synced_is_no_reason_not_to_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fsync(fd: int) -> None:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(os, "fsync", fsync)
    code = errno.EINVAL
    DiskFile(tmp_path / "on_a_network").close()
    code = errno.EIO
    open_files = len(os.listdir("/proc/self/fd"))
    with pytest.raises(OSError, match="Input/output error"):
        DiskFile(tmp_path / "on_a_broken_disk")
    assert len(os.listdir("/proc/self/fd")) == open_files
    assert [path.name for path in tmp_path.iterdir()] == ["on_a_network"]


def test_a_descriptor_that_failed_to_close_is_never_used_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def close_and_fail(fd: int, close: Callable[[int], None] = os.close) -> None:
        close(fd)
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    file = DiskFile(tmp_path / "file")
    with monkeypatch.context() as patch:
        patch.setattr(os, "close", close_and_fail)
        with pytest.raises(OSError, match="Input/output error"):
            file.close()
    with (tmp_path / "other").open("wb"):  # gets the number of the descriptor
        with pytest.raises(OSError, match="Bad file descriptor"):
            file.write_at([b"wrong"], 0)
        file.close()
    assert (tmp_path / "other").read_bytes() == b""


@pytest.mark.parametrize("error", [None, OSError(errno.ENOSPC, "full"), KeyboardInterrupt()])
def test_a_file_is_replaced_when_the_new_one_is_whole_and_else_not(
    tmp_path: Path, error: BaseException | None
) -> None:
    target = tmp_path / "report.html"
    target.write_bytes(b"old")

    def write() -> None:
        with replaced_file(target) as stream:
            stream.write(b"new")
            stream.flush()
            assert target.read_bytes() == b"old"
            if error is not None:
                raise error

    with pytest.raises(type(error)) if error else nullcontext():
        write()
    assert target.read_bytes() == (b"old" if error else b"new")
    assert list(tmp_path.iterdir()) == [target]


def test_a_link_a_device_and_a_folder_are_not_replaced(tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.write_bytes(b"of another user")
    link = tmp_path / "link"
    link.symlink_to(other)
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    for target in (link, fifo, tmp_path, Path(os.devnull)):
        with pytest.raises(OSError, match="no regular file"), replaced_file(target):
            pass
    assert other.read_bytes() == b"of another user"
    assert sorted(tmp_path.iterdir()) == [fifo, link, other]


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


@pytest.mark.parametrize("shared", [False, True])
def test_recordings_keep_the_group_of_a_folder_that_hands_it_down(
    tmp_path: Path, shared: bool
) -> None:
    (tmp_path / "recordings").mkdir()
    (tmp_path / "recordings").chmod(0o2750)
    recording = begin(tmp_path / "recordings", shared=shared).close().file.parent
    assert stat.S_IMODE(recording.stat().st_mode) == (0o2750 if shared else 0o2700)
    assert stat.S_IMODE(recording.parent.stat().st_mode) == 0o2750


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


MEMBER = 65502

IMPORTS = """
from pathlib import Path
from robotctl.base.errors import UnreadableFile
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
from robotctl.cli.targets.recordings import select_recordings
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
