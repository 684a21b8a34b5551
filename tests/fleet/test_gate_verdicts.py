"""The verdicts of the gate: what fails is named, and what could not be read gets none."""

from __future__ import annotations

import errno
import fcntl
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from robotctl.collection import judgement
from robotctl.collection.gate import junit_text
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.types import Effect, Event
from robotctl.recording.read.source import LocalSource
from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Report
from robotctl.testing.drives import BEGIN_NS, drive, record
from tests.support.checked_drives import judged, wrong

ONE, TWO = "robot_1", "robot_2"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made")
    record(folder / ONE, drive(2.0))
    record(folder / TWO, drive(1.0))
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "recordings"))


def results(folder: Path) -> int:
    """Count the stored results."""
    return len(list((folder / ".gate").glob("*.json")))


def test_a_divergence_counts_whatever_version_recorded_it(folder: Path) -> None:
    record(folder / "old", wrong(drive(2.0)), version="0.0.1")
    record(folder / "old_and_right", drive(2.0), version="0.0.1")
    report = judged(folder)
    assert (report.counts()["diverged"], report.counts()["same"]) == (1, 3)
    ((path, result),) = report.failures().items()
    assert path.name == "old"
    found = r"after Tick at entry \d+: twist.linear: recorded 0.0\d+, decided 0.\d+"
    assert re.fullmatch(rf"{found} \(recorded by 0.0.1\)", result.says)


@pytest.mark.parametrize(
    "error", [AttributeError("no pose"), NameError("name 'x'"), RecursionError("too deep")]
)
def test_a_kernel_that_fails_diverges_there(
    folder: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    step = Kernel.step

    def failing(kernel: Kernel, event: Event) -> tuple[Effect, ...]:
        if event.t_ns > BEGIN_NS + 1_500_000_000:
            raise error
        return step(kernel, event)

    monkeypatch.setattr(Kernel, "step", failing)
    report = judged(folder)
    ((path, result),) = report.failures().items()
    assert path.name == ONE
    says = rf"after \w+ at entry \d+: the kernel fails: {type(error).__name__}: {error}"
    assert re.fullmatch(says, result.says)
    assert report.results[folder / TWO].verdict == "same"


class _Bug(Exception):
    pass


@pytest.fixture
def bug(monkeypatch: pytest.MonkeyPatch) -> None:
    """A robotctl that fails, outside all that it expects, at one recording."""

    def failing(path: Path) -> Report:
        if path.name == ONE:
            raise _Bug("what nothing expects")
        return check_recording(path)

    monkeypatch.setattr(judgement, "check_recording", failing)


@pytest.mark.usefixtures("bug")
def test_a_recording_at_which_robotctl_fails_is_named_and_all_others_are_judged(
    folder: Path,
) -> None:
    report = judged(folder)
    ((path, result),) = report.failures().items()
    assert (path.name, result.verdict) == (ONE, "crashed")
    says = r"robotctl failed in \w+\.py, line \d+: _Bug: what nothing expects"
    assert re.fullmatch(says, result.says)
    assert report.results[folder / TWO].verdict == "same"
    assert results(folder) == 1, "a failure is tried again"
    assert 'failures="1"' in junit_text(report)


def test_parameters_that_do_not_fit_are_no_damage(folder: Path) -> None:
    report = judged(folder, settings={"limits.linear_mps": "0.0001"})
    for result in report.unknown().values():
        assert result.verdict == "unfit"
        assert result.says.startswith("the parameters do not fit: ")
    assert len(report.unknown()) == 2


def test_parameters_that_do_not_fit_hide_no_divergence(folder: Path) -> None:
    record(folder / "wrong", wrong(drive(2.0)))
    report = judged(folder, settings={"limits.linear_mps": "0.0001"})
    assert [path.name for path in report.failures()] == ["wrong"]


def test_a_kernel_that_fails_with_other_parameters_alone_closes_the_gate(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    step = Kernel.step

    def failing(kernel: Kernel, event: Event) -> tuple[Effect, ...]:
        if kernel.params.tracking.k_y == 7.0 and event.t_ns > BEGIN_NS + 1_500_000_000:
            raise ValueError("k_y")
        return step(kernel, event)

    monkeypatch.setattr(Kernel, "step", failing)
    report = judged(folder, settings={"tracking.k_y": "7.0"})
    assert [path.name for path in report.failures()] == [ONE]
    ((cause, _),) = report.causes().items()
    assert cause == "changed: the kernel fails with other parameters"


def test_a_changed_list_of_files_is_judged_again(folder: Path) -> None:
    assert judged(folder).counts()["same"] == 2
    metadata = folder / ONE / "metadata.yaml"
    text = metadata.read_text()
    counts = re.sub(r"message_count: (\d+)", lambda found: f"message_count: 9{found[1]}", text)
    metadata.write_text(counts)
    report = judged(folder)
    assert report.stored == 1
    assert [path.name for path in report.unknown()] == [ONE]
    metadata.unlink()
    assert judged(folder).stored == 1


def after_hashing(
    monkeypatch: pytest.MonkeyPatch, name: str, action: Callable[[Path], object]
) -> None:
    """Disturb a recording once, between the reading of its content and its check."""
    left = [name]

    def disturbed(path: Path) -> Report:
        if path.name in left:
            left.remove(name)
            action(path)
        return check_recording(path)

    monkeypatch.setattr(judgement, "check_recording", disturbed)


def _append(path: Path) -> None:
    (file,) = path.glob("*.mcap")
    with file.open("ab") as opened:
        opened.write(b"\0")


def _replace(path: Path) -> None:
    (file,) = path.glob("*.mcap")
    data, status = file.read_bytes(), file.stat()
    file.unlink()
    file.write_bytes(data[:-1] + b"\0")
    os.utime(file, ns=(status.st_atime_ns, status.st_mtime_ns))


def _remove_metadata(path: Path) -> None:
    (path / "metadata.yaml").unlink()


@pytest.mark.parametrize("action", [_append, _replace, _remove_metadata, shutil.rmtree])
def test_what_changes_while_it_is_judged_is_named_and_gets_no_verdict(
    folder: Path, monkeypatch: pytest.MonkeyPatch, action: Callable[[Path], object]
) -> None:
    after_hashing(monkeypatch, ONE, action)
    report = judged(folder)
    ((path, said),) = report.lost.items()
    assert path.name == ONE
    assert "was changed while it was read" in said or "No such file" in said
    assert (list(report.results), results(folder)) == ([folder / TWO], 1)


@pytest.mark.parametrize("call", ["open", "read"])
def test_a_disk_that_fails_for_a_moment_gives_no_verdict(
    folder: Path, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    shutil.rmtree(folder / TWO)
    begin, read = LocalSource.__init__, LocalSource.read
    failing = False

    def fail(path: Path) -> None:
        nonlocal failing
        failing = True

    def opened(source: LocalSource, path: Path, *more: object) -> None:
        nonlocal failing
        if failing and call == "open":
            failing = False
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        begin(source, path, *more)  # type: ignore[arg-type]

    def bytes_read(source: LocalSource, offset: int, length: int) -> bytes:
        nonlocal failing
        if failing and call == "read" and offset > 1000:
            failing = False
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return read(source, offset, length)

    monkeypatch.setattr(LocalSource, "__init__", opened)
    monkeypatch.setattr(LocalSource, "read", bytes_read)
    after_hashing(monkeypatch, ONE, fail)
    report = judged(folder)
    ((path, said),) = report.lost.items()
    assert path.name == ONE
    assert "Input/output error" in said
    assert results(folder) == 0
    assert not failing
    assert judged(folder).counts()["same"] == 1


def test_a_recording_that_is_being_written_is_named_and_left_out(folder: Path) -> None:
    (file,) = (folder / ONE).glob("*.mcap")
    with file.open("rb+") as written:
        fcntl.flock(written, fcntl.LOCK_EX)
        report = judged(folder)
        assert report.live == [folder / ONE]
        assert (list(report.results), report.lost, results(folder)) == ([folder / TWO], {}, 1)
        assert 'skipped="1"' in junit_text(report)
    assert len(judged(folder).results) == 2


def test_a_device_among_the_recordings_holds_up_nothing(folder: Path) -> None:
    (folder / "fifo").mkdir()
    os.mkfifo(folder / "fifo/fifo_0.mcap")
    report = judged(folder)
    assert [path.name for path in report.lost] == ["fifo"]
    assert report.counts()["same"] == 2
