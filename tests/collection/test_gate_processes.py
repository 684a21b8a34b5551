"""The gate's processes: a Dask cluster, Ray, and a gate that is killed."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from robotctl.base.errors import Refused, UsageError
from robotctl.check.report import Report
from robotctl.check.run import check_recording
from robotctl.collection import cluster, judgement
from robotctl.collection.cluster import Cluster
from robotctl.collection.gate import Baseline, judge_all
from robotctl.collection.judgement import software_hash
from robotctl.collection.judging import Judged, Judging, ResultStore
from robotctl.testing.drives import drive, record
from tests.collection.dask_processes import DaskProcesses, dask_processes
from tests.support.checked_drives import altered
from tests.support.lines import run_program
from tests.support.waiting import until

WORKERS = 3


class _ResultsHere(ResultStore):
    """Results that another machine looks for elsewhere, as a folder that it does not share."""

    def __str__(self) -> str:
        return f"{super().__str__()}/elsewhere"


class _Bug(Exception):
    pass


class _Failing(Judging):
    """Jobs at which robotctl fails in one recording, as with a bug of the kernel."""

    def judged(self, path: Path) -> Judged:
        def failing(path: Path) -> Report:
            if path.name == "robot_0002":
                raise _Bug("what nothing expects")
            return check_recording(path)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(judgement, "check_recording", failing)
            return super().judged(path)


@pytest.fixture(scope="module")
def dask() -> Iterator[DaskProcesses]:
    with dask_processes(WORKERS) as started:
        yield started


@pytest.fixture
def engine(dask: DaskProcesses, tmp_path: Path) -> Any:
    """The judging by the cluster."""
    return Cluster(dask.address, tmp_path).judge


@pytest.fixture
def results(tmp_path: Path) -> ResultStore:
    return ResultStore(tmp_path / "results")


@pytest.fixture
def judging(results: ResultStore) -> Judging:
    return Judging({}, results, software_hash())


def ignore(done: int, total: int) -> None:
    """Take the progress."""


def make_recordings(folder: Path, count: int, seconds: float = 1.0) -> list[Path]:
    """Make recordings that differ in their hash; every tenth is decided differently.

    They are two files under many names, which are part of the hash.
    """
    written = drive(seconds)
    wrong, _ = altered(written, "PublishTwist", '"linear":0.', '"linear":0.0')
    files = [
        next(record(folder / "made" / name, each).glob("*.mcap"))
        for name, each in (("good", written), ("wrong", wrong))
    ]
    recordings = [folder / f"robot_{number:04}" for number in range(count)]
    for number, recording in enumerate(recordings):
        recording.mkdir()
        (recording / f"{recording.name}_0.mcap").hardlink_to(files[number % 10 == 9])
    return recordings


def stored(folder: Path) -> int:
    """Count the results in a folder."""
    return len(list(folder.glob("*.json")))


@pytest.mark.parametrize("count", [20, pytest.param(1000, marks=pytest.mark.slow)])
def test_a_killed_worker_and_a_restarted_scheduler_lose_no_result_and_count_none_twice(
    dask: DaskProcesses, engine: Any, results: ResultStore, tmp_path: Path, count: int
) -> None:
    recordings = make_recordings(tmp_path / "recordings", count)
    at_restart: list[int] = []

    def disturb(done: int, total: int) -> None:
        assert total == count
        if done == count // 8:
            dask.kill_worker()
        if done == count // 4:
            dask.kill_scheduler()
            at_restart.append(stored(tmp_path / "results"))
            dask.restart()

    report = judge_all(recordings, results, {}, Baseline(), engine, disturb)
    assert list(report.results) == recordings
    counted = {verdict: number for verdict, number in report.counts().items() if number}
    assert counted == {"same": 9 * count // 10, "diverged": count // 10}
    left = stored(tmp_path / "results")
    assert at_restart[0] < left == count, "nothing was left for the new scheduler"
    again = judge_all(recordings, results, {}, Baseline(), engine)
    assert (again.stored, again.results) == (count, report.results)


def test_a_worker_with_another_robotctl_is_named(
    engine: Any, results: ResultStore, tmp_path: Path
) -> None:
    judging = Judging({}, results, "another")
    with pytest.raises(Refused, match=r"the worker tcp://127\.0\.0\.1:\d+ has another robotctl"):
        list(engine(judging, [tmp_path], ignore))
    with pytest.raises(Refused, match="has another robotctl"):  # one that joins later
        judging.judged(tmp_path)


def test_a_worker_that_sees_no_recordings_says_so(
    dask: DaskProcesses, engine: Any, judging: Judging, tmp_path: Path
) -> None:
    hidden = Cluster(dask.address, tmp_path / "nowhere").judge
    with pytest.raises(Refused, match=r"the worker .* does not see .*nowhere: give --in a folder"):
        list(hidden(judging, [tmp_path], ignore))
    ((_, answer),) = engine(judging, [tmp_path / "gone"], ignore)
    assert answer is not None
    assert re.fullmatch(r"\S+ cannot read it: .*gone cannot be read: No such .*", answer.problem)
    assert list((tmp_path / "results").iterdir()) == []


def test_a_worker_that_does_not_see_the_results_is_refused_before_it_judges(
    engine: Any, tmp_path: Path
) -> None:
    recordings = make_recordings(tmp_path / "recordings", 3)
    with pytest.raises(
        Refused, match=r"the worker tcp://\S+ does not see the results in .*results"
    ):
        judge_all(recordings, _ResultsHere(tmp_path / "results"), {}, Baseline(), engine)
    assert list((tmp_path / "results").iterdir()) == []


def test_a_late_worker_that_does_not_see_the_results_judges_nothing(
    judging: Judging, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (recording,) = make_recordings(tmp_path / "recordings", 1)
    monkeypatch.setattr(Judging, "judged", lambda *_: pytest.fail("it judged"))
    with pytest.raises(Refused, match="does not see the results"):
        cluster._judged("no.token", judging, recording)


def test_a_recording_at_which_a_worker_fails_is_named_and_all_others_are_judged(
    engine: Any, results: ResultStore, tmp_path: Path
) -> None:
    recordings = make_recordings(tmp_path / "recordings", 6)
    judging = _Failing({}, results, software_hash())
    answers = dict(engine(judging, recordings, ignore))
    judged = [answers[each] for each in recordings]
    verdicts = [each.judgement.verdict for each in judged if each and each.judgement]
    assert verdicts == ["same", "same", "crashed", "same", "same", "same"]
    assert stored(tmp_path / "results") == 5


def test_results_that_cannot_be_stored_are_refused(
    engine: Any, results: ResultStore, tmp_path: Path
) -> None:
    (recording,) = make_recordings(tmp_path / "recordings", 1)
    (tmp_path / "results").touch()
    with pytest.raises(Refused, match=r"cannot (read|write) results in .*/results: [A-Z]"):
        judge_all([recording], results, {}, Baseline(), engine)


@pytest.mark.parametrize(("listens", "why"), [(False, ".*refused"), (True, "timed out")])
def test_what_is_not_there_or_no_scheduler_is_refused(
    judging: Judging, tmp_path: Path, listens: bool, why: str
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        if not listens:
            server.close()
        engine = Cluster(address, tmp_path, connect_s=0.1).judge
        with pytest.raises(Refused, match=f"no Dask scheduler answers at {address}: {why}"):
            list(engine(judging, [tmp_path], ignore))


def test_a_cluster_without_workers_is_refused(judging: Judging, tmp_path: Path) -> None:
    with dask_processes(workers=0) as empty:
        engine = Cluster(empty.address, tmp_path, patience_s=0.1).judge
        with pytest.raises(Refused, match="has no workers: start some"):
            list(engine(judging, [tmp_path], ignore))


@pytest.mark.parametrize("address", ["tcp://", "10.0.0.5:8786", "http://host:80", "tcp://h:99999"])
def test_an_address_that_is_none_is_named(address: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no address of a cluster: give tcp://HOST:PORT"):
        Cluster(address, tmp_path)


def test_without_dask_one_sentence_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(
        UsageError, match=r"a cluster needs Dask.*pip install 'robotctl\[cluster\]'"
    ):
        Cluster("tcp://127.0.0.1:8786", tmp_path)


RECORDINGS = 8
STORED_FIRST = 2


def gate(many: Path) -> list[str]:
    program = "from robotctl.cli.app import main; main()"
    return [sys.executable, "-c", program, "gate", "--in", str(many), "--json"]


def stored_results(many: Path) -> dict[str, tuple[int, int]]:
    """Return the results by name, each with what changes if it is written again."""
    found = [(each.name, each.stat()) for each in (many / ".gate").glob("*.json")]
    return {name: (status.st_ino, status.st_mtime_ns) for name, status in found}


def has_ended(process: psutil.Process) -> bool:
    """Return whether a process has ended, also if nothing has collected it yet."""
    try:
        return bool(process.status() == psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return True


@pytest.fixture
def many(tmp_path: Path) -> Path:
    """Recordings that take a while: one file under many names, which are part of the hash."""
    (file,) = record(tmp_path / "made", drive(8.0)).glob("*.mcap")
    for number in range(RECORDINGS):
        recording = tmp_path / f"recordings/robot_{number:02}"
        recording.mkdir(parents=True)
        (recording / f"{recording.name}_0.mcap").hardlink_to(file)
    return tmp_path / "recordings"


def test_a_killed_gate_leaves_no_process_and_the_next_judges_only_what_is_left(many: Path) -> None:
    process = subprocess.Popen(
        gate(many), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    try:
        until(lambda: len(stored_results(many)) >= STORED_FIRST)
        children = psutil.Process(process.pid).children(recursive=True)
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        until(lambda: all(map(has_ended, children)))
    finally:
        process.kill()
        process.wait()
    before = stored_results(many)
    assert STORED_FIRST <= len(before) < RECORDINGS
    ran = run_program(*gate(many))
    ran.succeeded()
    answer = ran.summary
    assert (answer["stored"], answer["counts"]["same"]) == (len(before), RECORDINGS)
    after = stored_results(many)
    assert len(after) == RECORDINGS
    assert {name: after[name] for name in before} == before


FLEET_PAGE = Path(__file__).parents[2] / "docs/fleet.md"


@pytest.mark.slow
def test_the_gate_runs_on_ray(tmp_path: Path) -> None:
    pytest.importorskip("ray", reason="Ray has 240 MB: no extra brings it")
    (program,) = re.findall(r"```python\n(import sys\n.*?)```", FLEET_PAGE.read_text(), re.DOTALL)
    for name in ("one", "two"):
        record(tmp_path / name, drive(1.0))
    environment = os.environ | {"RAY_AUTH_MODE": "disabled", "RAY_USAGE_STATS_ENABLED": "0"}
    command = (sys.executable, "-c", program, tmp_path)
    run_program(*command, env=environment, timeout=None).succeeded("'same': 2")
    assert len(list((tmp_path / ".gate").iterdir())) == 2
