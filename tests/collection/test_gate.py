"""The gate judges a recording once, and names what is wrong; a baseline accepts what was seen."""

from __future__ import annotations

import errno
import fcntl
import hashlib
import json
import os
import re
import shutil
import signal
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from robotctl.base import pool
from robotctl.base.errors import ConfigError, RobotctlError
from robotctl.base.pool import local_processes, results_of
from robotctl.check import compare
from robotctl.check import report as check_report
from robotctl.check.report import Report, Verdict
from robotctl.check.run import check_recording
from robotctl.collection import gate as gates
from robotctl.collection import judgement, judging
from robotctl.collection.gate import Baseline, GateReport, junit_text, read_baseline
from robotctl.collection.judgement import judge
from robotctl.collection.judging import ResultStore
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.types import Effect, Event
from robotctl.recording.read.files import LocalSource
from robotctl.testing.drives import BEGIN_NS, drive, record
from tests.support.checked_drives import judged, rechained, wrong
from tests.support.lines import run_program

GOOD, WRONG = "robot_20260101_120000", "robot_20260102_120000"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("gate")
    written = drive(2.0)
    record(folder / GOOD, written)
    record(folder / WRONG, wrong(written))
    return folder


@pytest.fixture
def recordings(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "recordings"))


def test_what_is_decided_differently_closes_the_gate_with_its_first_cause(recordings: Path) -> None:
    report = judged(recordings)
    assert report.counts()[Verdict.DIVERGED] == report.counts()[Verdict.SAME] == 1
    assert list(report.failures()) == [recordings / WRONG]
    ((cause, paths),) = report.causes().items()
    assert cause.startswith("diverged: after Tick at entry N: ")
    assert paths == [recordings / WRONG]


def test_nothing_is_judged_twice_by_the_same_software(
    recordings: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = judged(recordings)
    monkeypatch.setattr(judging, "judge", lambda *_, **__: pytest.fail("it was judged again"))
    second = judged(recordings)
    assert (first.stored, second.stored) == (0, 2)
    assert second.results == first.results


def test_other_software_or_parameters_or_bytes_are_judged_again(
    recordings: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    judged(recordings)
    assert judged(recordings, settings={"limits.linear_mps": "0.3"}).stored == 0
    (file,) = (recordings / GOOD).glob("*.mcap")
    file.write_bytes(file.read_bytes() + b"\0")
    assert judged(recordings).stored == 1
    for module in (gates, judgement, judging):
        monkeypatch.setattr(module, "software_hash", lambda: "another")
    assert judged(recordings).stored == 0


def test_the_report_for_continuous_integration_names_each_recording(recordings: Path) -> None:
    report = judged(recordings)
    report.lost[recordings / "gone\x1b"] = "the process that judged it was killed"
    suite = ElementTree.fromstring(junit_text(report))
    assert (suite.get("tests"), suite.get("failures"), suite.get("errors")) == ("3", "1", "1")
    cases = {each.get("name"): [child.tag for child in each] for each in suite}
    assert cases == {GOOD: [], WRONG: ["failure"], "gone\\x1b": ["error"]}


def test_a_result_is_stored_once(made: Path, tmp_path: Path) -> None:
    results = ResultStore(tmp_path)
    result = judge(made / GOOD, {})
    assert results.get(result.key) is None
    assert results.put(result) == result
    (stored,) = tmp_path.iterdir()
    before = stored.stat()
    assert results.put(result) == result
    after = stored.stat()
    assert (after.st_ino, after.st_mtime_ns) == (before.st_ino, before.st_mtime_ns)


def die_at(path: Path) -> str:
    """Be killed: each time at `always`, the first time at `once`."""
    if path.name == "always" or (path.name == "once" and not path.exists()):
        path.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return path.name


@pytest.mark.parametrize(("deadly", "result"), [("once", "once"), ("always", None)])
def test_a_kill_loses_no_other_result(tmp_path: Path, deadly: str, result: str | None) -> None:
    names = ["first", deadly, "last"]
    found = list(results_of(die_at, [tmp_path / name for name in names], local_processes))
    assert sorted((path.name, said or "") for path, said in found) == sorted(
        [("first", "first"), ("last", "last"), (deadly, result or "")]
    )


def fail_with(number: int, *arguments: object, **options: object) -> None:
    raise OSError(number, os.strerror(number))


def test_without_shared_memory_a_sentence_names_the_cure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool, "ProcessPoolExecutor", partial(fail_with, errno.EROFS))
    with pytest.raises(RobotctlError, match=r"/dev/shm.*: Read-only file system \(make it"):
        list(results_of(die_at, [Path("one"), Path("two")], local_processes))


def test_too_few_open_files_are_not_blamed_on_shared_memory(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(pool, "ProcessPoolExecutor", partial(fail_with, errno.EMFILE))
    with pytest.raises(OSError, match="Too many open files"), local_processes(2):
        pass


def test_an_unreadable_recording_is_unknown(recordings: Path) -> None:
    for file in (recordings / GOOD).glob("*.mcap"):
        file.write_bytes(b"no MCAP")
    report = judged(recordings)
    assert list(report.unknown()) == [recordings / GOOD]


NAME = "robot_1"
SETTINGS = {"limits.linear_mps": "0.3"}


@pytest.fixture(scope="module")
def one_short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("short")
    record(folder / NAME, drive(0.5))
    return folder


def sealed(change: Callable[[dict[str, Any]], object]) -> Callable[[bytes], bytes]:
    """Return a damage of the result whose hash is right, as a program that is wrong makes it."""

    def damaged(data: bytes) -> bytes:
        result = json.loads(data)["result"]
        change(result)
        text = json.dumps(result, sort_keys=True)
        digest = hashlib.sha256(text.encode()).hexdigest()
        return json.dumps({"sha256": digest, "result": result}).encode()

    return damaged


DAMAGES: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda data: b"",
    "half": lambda data: data[: len(data) // 2],
    "zeros": lambda data: bytes(len(data)),
    "no UTF-8": lambda data: b"\xff" + data,
    "another value": lambda data: b"[1]",
    "nested": lambda data: b"[" * 100_000,
    "another verdict": lambda data: data.replace(b'"same"', b'"broken"'),
    "a brace": lambda data: b"{",
    "a bit in a number": lambda data: data.replace(b'"ticks": 2', b'"ticks": 3'),
    "too large": lambda data: data + b" " * 100_000,
    "no such verdict": sealed(lambda result: result.update(verdict="fine")),
    "settings of None": sealed(lambda result: result.update(settings=None)),
    "a number as the hash": sealed(lambda result: result.update(recording=5)),
    "another recording": sealed(lambda result: result.update(recording="0" * 64)),
    "no cause": sealed(lambda result: result.pop("cause")),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_result_is_made_again(
    one_short: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, damage: str
) -> None:
    monkeypatch.setattr(judging, "MAX_BYTES", 50_000)
    results = ResultStore(tmp_path)
    result = results.put(judge(one_short / NAME, SETTINGS))
    assert results.get(result.key) == result
    (stored,) = tmp_path.iterdir()
    data = stored.read_bytes()
    damaged = DAMAGES[damage](data)
    assert damaged != data
    stored.write_bytes(damaged)
    assert results.get(result.key) is None
    assert results.put(result) == result
    assert results.get(result.key) == result


def test_no_thread_meets_a_class_that_is_not_prepared() -> None:
    """Two threads in which msgspec prepares the same class crash Python."""
    program = (
        "from robotctl.collection import gate, judgement, judging\n"
        "kinds = judging._Sealed, judgement.Judgement, gate._File, gate.Accepted\n"
        "print([kind.__name__ for kind in kinds if '__msgspec_cache__' not in vars(kind)])"
    )
    assert run_program(sys.executable, "-c", program).succeeded() == "[]\n"


def test_programs_for_the_version_before_still_find_the_gate() -> None:
    program = (
        "from robotctl.fleet.baseline import Baseline\n"
        "from robotctl.fleet.gate import judge_all\n"
        "from robotctl.fleet.judging import judge_here\n"
        "from robotctl.fleet.result_store import ResultStore\n"
    )
    run_program(sys.executable, "-c", program).succeeded()


def test_a_run_over_damaged_results_judges_again_and_repairs_them(one_short: Path) -> None:
    first = judged(one_short)
    (stored,) = (one_short / ".gate").glob("*.json")
    stored.write_text('{"sha256": null}')
    second, third = judged(one_short), judged(one_short)
    assert (first.stored, second.stored, third.stored) == (0, 0, 1)
    assert first.results == second.results == third.results


ONE, TWO = "robot_1", "robot_2"


@pytest.fixture(scope="module")
def sound_ones(tmp_path_factory: pytest.TempPathFactory) -> Path:
    sound = tmp_path_factory.mktemp("sound_ones")
    record(sound / ONE, drive(2.0))
    record(sound / TWO, drive(1.0))
    return sound


@pytest.fixture
def sound(sound_ones: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(sound_ones, tmp_path / "recordings"))


def results(sound: Path) -> int:
    """Count the stored results."""
    return len(list((sound / ".gate").glob("*.json")))


def test_a_divergence_counts_whatever_version_recorded_it(sound: Path) -> None:
    record(sound / "old", wrong(drive(2.0)), version="0.0.1")
    record(sound / "old_and_right", drive(2.0), version="0.0.1")
    report = judged(sound)
    assert (report.counts()["diverged"], report.counts()["same"]) == (1, 3)
    ((path, result),) = report.failures().items()
    assert path.name == "old"
    found = r"after Tick at entry \d+: twist.linear: recorded 0.0\d+, decided 0.\d+"
    assert re.fullmatch(rf"{found} \(recorded by 0.0.1\)", result.says)


def late(monkeypatch: pytest.MonkeyPatch, failing: Callable[[Kernel], None]) -> None:
    """Let each kernel fail so at its events after 1.5 s."""
    step = Kernel.step

    def patched(kernel: Kernel, event: Event) -> tuple[Effect, ...]:
        if event.t_ns > BEGIN_NS + 1_500_000_000:
            failing(kernel)
        return step(kernel, event)

    monkeypatch.setattr(Kernel, "step", patched)


@pytest.mark.parametrize(
    "error", [AttributeError("no pose"), NameError("name 'x'"), RecursionError("too deep")]
)
def test_a_kernel_that_fails_diverges_there(
    sound: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def failing(kernel: Kernel) -> None:
        raise error

    late(monkeypatch, failing)
    report = judged(sound)
    ((path, result),) = report.failures().items()
    assert path.name == ONE
    says = rf"after \w+ at entry \d+: the kernel fails: {type(error).__name__}: {error}"
    assert re.fullmatch(says, result.says)
    assert report.results[sound / TWO].verdict == "same"


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
def test_a_recording_at_which_robotctl_fails_is_named_and_others_are_judged(sound: Path) -> None:
    report = judged(sound)
    ((path, result),) = report.failures().items()
    assert (path.name, result.verdict) == (ONE, "crashed")
    says = r"robotctl failed in \w+\.py, line \d+: _Bug: what nothing expects"
    assert re.fullmatch(says, result.says)
    assert report.results[sound / TWO].verdict == "same"
    assert results(sound) == 1, "a failure is tried again"
    assert 'failures="1"' in junit_text(report)


def test_parameters_that_do_not_fit_are_no_damage(sound: Path) -> None:
    report = judged(sound, settings={"limits.linear_mps": "0.0001"})
    for result in report.unknown().values():
        assert result.verdict == "unfit"
        assert result.says.startswith("the parameters do not fit: ")
    assert len(report.unknown()) == 2


def test_a_kernel_that_fails_with_other_parameters_alone_closes_the_gate(
    sound: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(kernel: Kernel) -> None:
        if kernel.params.tracking.k_y == 7.0:
            raise ValueError("k_y")

    late(monkeypatch, failing)
    report = judged(sound, settings={"tracking.k_y": "7.0"})
    assert [path.name for path in report.failures()] == [ONE]
    ((cause, _),) = report.causes().items()
    assert cause == "changed: the kernel fails with other parameters"


def test_a_changed_list_of_files_is_judged_again(sound: Path) -> None:
    assert judged(sound).counts()["same"] == 2
    metadata = sound / ONE / "metadata.yaml"
    text = metadata.read_text()
    counts = re.sub(r"message_count: (\d+)", lambda found: f"message_count: 9{found[1]}", text)
    metadata.write_text(counts)
    report = judged(sound)
    assert report.stored == 1
    assert [path.name for path in report.unknown()] == [ONE]
    metadata.unlink()
    assert judged(sound).stored == 1


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
    sound: Path, monkeypatch: pytest.MonkeyPatch, action: Callable[[Path], object]
) -> None:
    after_hashing(monkeypatch, ONE, action)
    report = judged(sound)
    ((path, said),) = report.lost.items()
    assert path.name == ONE
    assert "was changed while it was read" in said or "No such file" in said
    assert (list(report.results), results(sound)) == ([sound / TWO], 1)


@pytest.mark.parametrize("call", ["open", "read"])
def test_a_disk_that_fails_for_a_moment_gives_no_verdict(
    sound: Path, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    shutil.rmtree(sound / TWO)
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
    report = judged(sound)
    ((path, said),) = report.lost.items()
    assert path.name == ONE
    assert "Input/output error" in said
    assert results(sound) == 0
    assert not failing
    assert judged(sound).counts()["same"] == 1


def test_a_recording_that_is_being_written_is_named_and_left_out(sound: Path) -> None:
    (file,) = (sound / ONE).glob("*.mcap")
    with file.open("rb+") as written:
        fcntl.flock(written, fcntl.LOCK_EX)
        report = judged(sound)
        assert report.live == [sound / ONE]
        assert (list(report.results), report.lost, results(sound)) == ([sound / TWO], {}, 1)
        assert 'skipped="1"' in junit_text(report)
    assert len(judged(sound).results) == 2


def test_a_device_among_the_recordings_holds_up_nothing(sound: Path) -> None:
    (sound / "fifo").mkdir()
    os.mkfifo(sound / "fifo/fifo_0.mcap")
    report = judged(sound)
    assert [path.name for path in report.lost] == ["fifo"]
    assert report.counts()["same"] == 2


def accepted(report: GateReport, file: Path) -> Baseline:
    """Accept what is wrong, and return the baseline as the next run reads it."""
    baseline = read_baseline(file)
    for path, result in (report.failures() | report.unknown()).items():
        baseline.accept(path.name, result, by="ann", why="a shorter ramp", at="2026-01-01")
    baseline.write(file)
    return read_baseline(file)


def test_what_is_accepted_passes_and_says_by_whom(sound: Path, tmp_path: Path) -> None:
    record(sound / "other", wrong(drive(2.0)))
    baseline = accepted(judged(sound), tmp_path / "baseline.json")
    again = judged(sound, baseline)
    assert again.failures() == {}
    assert again.acceptances() == {("ann", "2026-01-01", "a shorter ramp"): [sound / "other"]}


def test_an_accepted_divergence_passes_no_later_one(
    sound: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = drive(2.0, snapshots_s=(0.0, 1.0))
    end = next(n for n, each in enumerate(written) if n and getattr(each, "name", "") == "Snapshot")
    record(sound / "other", rechained([*wrong(written[:end]), *written[end:]]))
    baseline = accepted(judged(sound), tmp_path / "baseline.json")
    assert judged(sound, baseline).failures() == {}
    step = Kernel.step

    def silent_later(kernel: Kernel, event: Event) -> tuple[Effect, ...]:
        effects = step(kernel, event)
        return () if event.t_ns > BEGIN_NS + 1_500_000_000 else effects

    monkeypatch.setattr(Kernel, "step", silent_later)
    shutil.rmtree(sound / ".gate")
    assert sound / "other" in judged(sound, baseline).failures()


def test_what_was_accepted_passes_with_the_next_version_too(
    sound: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record(sound / "other", wrong(drive(2.0)))
    baseline = accepted(judged(sound), tmp_path / "baseline.json")
    for module in (check_report, compare, judgement):
        monkeypatch.setattr(module, "__version__", "9.9.9")
    shutil.rmtree(sound / ".gate")
    again = judged(sound, baseline)
    assert list(again.accepted) == [sound / "other"]
    assert "recorded by" in again.results[sound / "other"].says


def test_another_recording_with_that_difference_fails(sound: Path, tmp_path: Path) -> None:
    record(sound / "other", wrong(drive(2.0)))
    baseline = accepted(judged(sound), tmp_path / "baseline.json")
    shutil.rmtree(sound / "other")
    record(sound / "other", wrong(drive(2.5)))
    assert list(judged(sound, baseline).failures()) == [sound / "other"]


def test_the_place_of_a_recording_makes_no_difference(sound: Path, tmp_path: Path) -> None:
    (file,) = (sound / ONE).glob("*.mcap")
    file.write_bytes(file.read_bytes()[:-200])
    baseline = accepted(judged(sound), tmp_path / "baseline.json")
    elsewhere = Path(shutil.copytree(sound, tmp_path / "elsewhere"))
    shutil.rmtree(elsewhere / ".gate")
    again = judged(elsewhere, baseline)
    assert list(again.accepted) == [elsewhere / ONE]


def test_a_baseline_of_an_older_robotctl_is_refused_with_the_reason(tmp_path: Path) -> None:
    file = tmp_path / "baseline.json"
    old = ("name", "recording", "verdict", "cause", "by", "why", "at")
    file.write_text(json.dumps({"accepted": [dict.fromkeys(old, "")]}))
    with pytest.raises(ConfigError, match=r"an older robotctl wrote it.*: name a new file"):
        read_baseline(file)


@pytest.mark.parametrize(
    "text",
    [
        *("", "[]", "[", "[" * 100_000),
        *('{"format": 2, "accepted": [{"name": 1}]}', '{"format": 3, "accepted": []}'),
    ],
)
def test_a_wrong_baseline_is_named(tmp_path: Path, text: str) -> None:
    file = tmp_path / "baseline.json"
    file.write_text(text)
    with pytest.raises(ConfigError, match="is not a baseline"):
        read_baseline(file)
