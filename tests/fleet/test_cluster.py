"""The gate on a Dask cluster: a scheduler and three workers over TCP, some of them killed."""

from __future__ import annotations

import re
import socket
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from robotctl.errors import Refused, UsageError
from robotctl.fleet.baseline import Baseline
from robotctl.fleet.cluster import Cluster
from robotctl.fleet.gate import judge_all
from robotctl.fleet.judgement import software_hash
from robotctl.fleet.judging import Judging
from robotctl.fleet.result_store import ResultStore
from robotctl.testing.drives import drive, record
from tests.support.checked_drives import altered

pytest.importorskip("distributed", reason="a cluster is an extra: robotctl[cluster]")

from tests.support.dask_processes import DaskProcesses, dask_processes


@pytest.fixture(scope="module")
def dask() -> Iterator[DaskProcesses]:
    with dask_processes(workers=3) as started:
        yield started


def make_recordings(folder: Path, count: int, seconds: float = 1.0) -> list[Path]:
    """Make recordings that differ in their hash; every tenth is decided differently."""
    written = drive(seconds)
    wrong, _ = altered(written, "PublishTwist", '"linear":0.', '"linear":0.0')
    return [
        record(folder / f"robot_{number:04}", wrong if number % 10 == 9 else written)
        for number in range(count)
    ]


def stored(folder: Path) -> int:
    """Count the results in a folder."""
    return len(list(folder.glob("*.json")))


def test_a_killed_worker_and_a_restarted_scheduler_lose_no_result_and_count_none_twice(
    dask: DaskProcesses, tmp_path: Path
) -> None:
    count = 40
    recordings = make_recordings(tmp_path / "recordings", count)
    results = tmp_path / "results"
    at_restart: list[int] = []

    def disturb(done: int, total: int) -> None:
        assert total == count
        if done == count // 4:
            dask.kill_worker()
        if done == count // 2:
            dask.kill_scheduler()
            at_restart.append(stored(results))
            dask.restart()

    engine = Cluster(dask.address, tmp_path).judge
    report = judge_all(recordings, ResultStore(results), {}, Baseline(), engine, disturb)
    assert list(report.results) == recordings
    assert (report.counts()["same"], report.counts()["diverged"]) == (36, 4)
    assert at_restart[0] < stored(results) == count, "nothing was left for the new scheduler"
    again = judge_all(recordings, ResultStore(results), {}, Baseline(), engine)
    assert (again.stored, again.results) == (count, report.results)


def test_a_worker_with_another_robotctl_is_refused_by_its_name(
    dask: DaskProcesses, tmp_path: Path
) -> None:
    engine = Cluster(dask.address, tmp_path).judge
    judging = Judging({}, ResultStore(tmp_path / "results"), "another")
    with pytest.raises(Refused, match=r"the worker tcp://127\.0\.0\.1:\d+ has another robotctl"):
        list(engine(judging, [tmp_path], lambda done, total: None))
    with pytest.raises(Refused, match="has another robotctl"):  # one that joins later
        judging.judged(tmp_path)


def test_a_worker_that_does_not_see_the_recordings_says_so(
    dask: DaskProcesses, tmp_path: Path
) -> None:
    judging = Judging({}, ResultStore(tmp_path / "results"), software_hash())
    hidden = Cluster(dask.address, tmp_path / "nowhere").judge
    with pytest.raises(Refused, match=r"the worker .* does not see .*nowhere: give --in a folder"):
        list(hidden(judging, [tmp_path], lambda done, total: None))
    engine = Cluster(dask.address, tmp_path).judge
    ((_, answer),) = engine(judging, [tmp_path / "gone"], lambda done, total: None)
    assert answer is not None
    assert re.fullmatch(r"\S+ cannot read it: .*gone cannot be read: No such .*", answer.problem)
    assert not (tmp_path / "results").exists()


def test_results_that_cannot_be_stored_are_refused(dask: DaskProcesses, tmp_path: Path) -> None:
    (recording,) = make_recordings(tmp_path / "recordings", 1)
    (tmp_path / "results").touch()
    engine = Cluster(dask.address, tmp_path).judge
    with pytest.raises(Refused, match=r"cannot read results: .*Not a directory"):
        judge_all([recording], ResultStore(tmp_path / "results"), {}, Baseline(), engine)


def test_a_cluster_that_is_not_there_is_refused(tmp_path: Path) -> None:
    judging = Judging({}, ResultStore(tmp_path / "results"), software_hash())
    with socket.create_server(("127.0.0.1", 0)) as free:
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    engine = Cluster(address, tmp_path, connect_s=0.1).judge
    with pytest.raises(Refused, match=f"no Dask scheduler answers at {address}: .*refused"):
        list(engine(judging, [tmp_path], lambda done, total: None))


def test_a_cluster_without_workers_is_refused(tmp_path: Path) -> None:
    judging = Judging({}, ResultStore(tmp_path / "results"), software_hash())
    with dask_processes(workers=0) as empty:
        engine = Cluster(empty.address, tmp_path, patience_s=0.1).judge
        with pytest.raises(Refused, match="has no workers: start some"):
            list(engine(judging, [tmp_path], lambda done, total: None))


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
