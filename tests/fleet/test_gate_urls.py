"""The gate over recordings in a store: nothing is read twice, and a failing store is no verdict."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

from robotctl.fleet.baseline import Baseline
from robotctl.fleet.gate import GateReport, judge_all
from robotctl.fleet.jobs import local_threads
from robotctl.fleet.judging import judge_here
from robotctl.fleet.result_store import ResultStore, opened_results
from robotctl.recording.keep.listing import recordings_in
from robotctl.store.opened_bucket import opened_bucket
from robotctl.store.store_path import path_of
from robotctl.testing.drives import drive, record
from tests.support.checked_drives import altered
from tests.support.faulty_bucket import FaultyBucket, serving

ROBOT = "robots/one"
NAMES = ["robot_1", "robot_2", "robot_3"]
URL = f"s3://{ROBOT}"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made")
    written = drive(2.0)
    wrong, _ = altered(written, "PublishTwist", '"linear":0.', '"linear":0.0')
    for name in NAMES:
        record(folder / name, wrong if name == NAMES[-1] else written)
    return folder


@pytest.fixture
def bucket(made: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[FaultyBucket]:
    """A bucket with three recordings; the second one lies there as `robotctl sync` stores it."""
    with serving(monkeypatch) as bucket:
        for path in made.glob("*/*"):
            hashed = "/" + "ab" * 32 if path.parent.name == NAMES[1] else ""
            bucket[f"one/{path.parent.name}{hashed}/{path.name}"] = path.read_bytes()
        yield bucket


def judged() -> GateReport:
    """Run the gate as another process would, which knows nothing of the store."""
    opened_bucket.cache_clear()
    opened_results.cache_clear()
    engine = partial(judge_here, processes=local_threads)
    store = ResultStore(f"{URL}/.gate")
    return judge_all(recordings_in(path_of(URL)), store, {}, Baseline(), engine)


def test_recordings_in_a_store_are_judged_like_those_of_a_folder(bucket: FaultyBucket) -> None:
    report = judged()
    assert [path.name for path in report.results] == NAMES
    assert [path.name for path in report.failures()] == NAMES[-1:]
    assert not report.lost
    assert sum(key.startswith("one/.gate/") for key in bucket.objects) == len(NAMES)


def test_a_second_run_reads_no_recording_and_lists_once(bucket: FaultyBucket) -> None:
    first = judged()
    asked: list[str] = []
    bucket.before = lambda served, method, key: asked.append(key)
    second = judged()
    assert (second.stored, second.results) == (len(NAMES), first.results)
    assert not [key for key in asked if key.endswith(".mcap")]
    assert len([key for key in asked if ".gate/" not in key]) == 1


def test_another_content_is_judged_again(bucket: FaultyBucket, made: Path) -> None:
    judged()
    (old,) = (key for key in bucket.objects if key.endswith("/robot_1_0.mcap"))
    (other,) = (made / NAMES[-1]).glob("*.mcap")
    bucket[old] = other.read_bytes()
    again = judged()
    assert again.stored == len(NAMES) - 1
    assert [path.name for path in again.failures()] == ["robot_1", "robot_3"]


def test_another_list_of_files_is_judged_again(bucket: FaultyBucket) -> None:
    judged()
    bucket["one/robot_1/metadata.yaml"] = b"other"
    assert judged().stored == len(NAMES) - 1


def test_a_store_that_fails_five_percent_changes_no_verdict(bucket: FaultyBucket) -> None:
    bucket.failing_share = bucket.short_share = 0.05
    report = judged()
    assert (report.counts()["same"], report.counts()["diverged"], report.lost) == (2, 1, {})


@pytest.mark.parametrize("what", ["replaced", "removed"])
def test_what_changes_during_a_check_is_named_and_gets_no_verdict(
    bucket: FaultyBucket, what: str
) -> None:
    def disturb(served: FaultyBucket, method: str, key: str) -> None:
        if method == "GET" and key.endswith("robot_1_0.mcap"):
            if what == "replaced":
                served[key] = b"x" * len(served.objects[key])
            else:
                served.objects.pop(key, None)

    bucket.before = disturb
    report = judged()
    ((path, said),) = report.lost.items()
    assert path.name == "robot_1"
    assert ("was changed while it was read" if what == "replaced" else "does not exist") in said
    assert len(report.results) == sum("/.gate/" in key for key in bucket.objects) == 2
