"""Questions over the recordings in a bucket: their indexes are copied once."""

from __future__ import annotations

import errno
import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

import pytest

from robotctl.errors import Refused
from robotctl.fleet import stored_catalogue as module
from robotctl.fleet.catalogue import Catalogue
from robotctl.fleet.questions import ask, find
from robotctl.fleet.recording_index import index_recording
from robotctl.fleet.stored_catalogue import stored_catalogue
from robotctl.store import StoreError, open_store
from robotctl.store.opened_bucket import opened_bucket
from robotctl.store.store_path import StorePath
from robotctl.testing.drives import drive, record
from tests.support.faulty_bucket import FaultyBucket, serving
from tests.support.s3_server import environment

pytest.importorskip("duckdb", reason="indexes are an extra: robotctl[parquet]")
pytest.importorskip("obstore", reason="URLs are an extra: robotctl[store]")

NAMES = ("robot_20260101_120000", "robot_20260102_120000")
URL = "s3://robots/day"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made")
    for number, name in enumerate(NAMES):
        assert index_recording(record(folder / name, drive(2.0 + number))) == ""
    return folder


@pytest.fixture
def bucket(made: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[FaultyBucket]:
    """A bucket with two recordings and their indexes: one by hand, one as `sync` copies it."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    with serving(monkeypatch) as bucket:
        for path in (made / NAMES[0]).iterdir():
            bucket[f"day/{NAMES[0]}/{path.name}"] = path.read_bytes()
        for path in (made / NAMES[1]).iterdir():
            data = path.read_bytes()
            bucket[f"day/{NAMES[1]}/{hashlib.sha256(data).hexdigest()}/{path.name}"] = data
        yield bucket


@pytest.fixture(autouse=True)
def indexed(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Index in this process, and return what was indexed."""
    done: list[str] = []

    def run(job: object, recordings: list[Path], *_: object) -> Iterator[tuple[Path, str]]:
        for each in recordings:
            done.append(each.name)
            yield each, job(each)  # type: ignore[operator]

    monkeypatch.setattr(module, "results_of", run)
    return done


@contextmanager
def catalogue(url: str = URL) -> Iterator[Catalogue]:
    """Open the catalogue as a new process does."""
    opened_bucket.cache_clear()
    with stored_catalogue(StorePath(url)) as opened:
        yield opened


def recordings(opened: Catalogue) -> dict[str, str]:
    rows = find(opened, "recordings", "").as_objects()
    return {row["recording"]: row["check"] for row in rows}


def test_the_indexes_in_a_bucket_are_read_once(bucket: FaultyBucket, indexed: list[str]) -> None:
    with catalogue() as opened:
        assert recordings(opened) == dict.fromkeys(NAMES, "same")
        assert ask(opened, "SELECT count(*) FROM samples").rows[0][0] > 30
    assert indexed == []
    bucket.requests = bucket.sent_bytes = 0
    with catalogue() as opened:
        assert recordings(opened) == dict.fromkeys(NAMES, "same")
    assert bucket.requests == 1  # a listing


def test_a_recording_without_an_index_is_indexed_and_its_index_put_beside_it(
    made: Path,
    indexed: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    s3_endpoint: str,
) -> None:
    for name, value in environment(s3_endpoint).items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    store = open_store(URL)
    for number, name in enumerate(NAMES):  # one by hand, one as `sync` copies it
        data = (made / name / f"{name}_0.mcap").read_bytes()
        hashed = f"{hashlib.sha256(data).hexdigest()}/" if number else ""
        store.put(f"{name}/{hashed}{name}_0.mcap", [data])
    with catalogue() as opened:
        assert recordings(opened) == dict.fromkeys(NAMES, "same")
    assert sorted(indexed) == list(NAMES)
    by_hand, collected = sorted(
        (each.key for each in store.list() if each.key.endswith("index.parquet")), key=len
    )
    assert by_hand == f"{NAMES[0]}/index.parquet"
    assert collected.split("/")[1] == hashlib.sha256(store.get(collected, 1 << 20)).hexdigest()
    indexed.clear()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "another user"))
    with catalogue() as opened:
        assert recordings(opened) == dict.fromkeys(NAMES, "same")
    assert indexed == []


def test_a_bucket_that_may_only_be_read_is_asked_all_the_same(bucket: FaultyBucket) -> None:
    del bucket.objects[f"day/{NAMES[0]}/index.parquet"]
    before = set(bucket.objects)
    bucket.before = lambda _, method, key: 403 if method in ("PUT", "POST") else None
    with catalogue() as opened:
        assert recordings(opened) == dict.fromkeys(NAMES, "same")
    assert set(bucket.objects) == before


def test_an_index_that_is_not_of_the_present_files_is_made_again(
    bucket: FaultyBucket, indexed: list[str], made: Path
) -> None:
    other = (made / NAMES[1] / "index.parquet").read_bytes()
    bucket[f"day/{NAMES[0]}/index.parquet"] = other
    with catalogue() as opened:
        assert recordings(opened) == dict.fromkeys(NAMES, "same")
    assert indexed == [NAMES[0]]
    bucket[f"day/{NAMES[0]}/index.parquet"] = b"PAR1 is not enough"
    file = f"day/{NAMES[0]}/{NAMES[0]}_0.mcap"
    bucket[file] = bucket.objects[file][:-1000]
    with catalogue() as opened:
        assert recordings(opened) == {NAMES[0]: "incomplete", NAMES[1]: "same"}


def test_single_files_below_a_url_are_recordings(
    made: Path,
    indexed: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    s3_endpoint: str,
) -> None:
    for name, value in environment(s3_endpoint).items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    data = (made / NAMES[0] / f"{NAMES[0]}_0.mcap").read_bytes()
    folder = f"{tmp_path.name}-files"
    bucket = open_store("s3://robots")
    bucket.put(f"{folder}/dock.mcap", [data])
    bucket.put(f"{folder}/yard/{'0' * 64}/yard.mcap", [data])
    for user in ("one", "another"):
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / user))
        with catalogue(f"s3://robots/{folder}") as opened:
            assert recordings(opened) == {"dock.mcap": "same", "yard": "same"}
    assert sorted(indexed) == ["dock.mcap", "yard"]
    names = {each.key.rpartition("/")[2] for each in bucket.list(folder)}
    assert names == {"dock.mcap", "dock.mcap.index.parquet", "yard.mcap", "index.parquet"}
    bucket.put("dock.mcap", [data])
    try:
        with catalogue("s3://robots") as opened:
            assert recordings(opened)["dock.mcap"] == "same"
        bucket.delete("dock.mcap.index.parquet")
    finally:
        bucket.delete("dock.mcap")


def test_two_questions_at_once_do_not_disturb_each_other(
    bucket: FaultyBucket, indexed: list[str]
) -> None:
    with catalogue() as first:
        before = set(first.path.parent.iterdir())
        unfinished = first.path.with_name(f".{first.path.name}.1.tmp")
        unfinished.touch()
        for key in [key for key in bucket.objects if NAMES[1] in key]:
            del bucket.objects[key]
        with catalogue() as second:
            assert recordings(second) == {NAMES[0]: "same"}
        assert before | {unfinished} <= set(first.path.parent.iterdir())
        assert recordings(first) == dict.fromkeys(NAMES, "same")
        assert ask(first, "SELECT count(*) FROM samples").rows[0][0] > 30
    with catalogue() as second:
        pass
    assert set(second.path.parent.iterdir()) == {second.path, *map(Path, second.indexes)}
    assert indexed == []


def test_an_index_that_nobody_has_looked_at_is_never_in_the_cache(
    bucket: FaultyBucket, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, indexed: list[str]
) -> None:
    wrong = bucket.objects[f"day/{NAMES[0]}/index.parquet"][:-9]
    bucket[f"day/{NAMES[0]}/index.parquet"] = wrong
    with monkeypatch.context() as patched:
        patched.setattr(module, "stamps_of_each", raise_interrupted)
        with pytest.raises(KeyboardInterrupt), catalogue():
            pass
    assert not list((tmp_path / "cache").rglob("*.parquet"))
    with catalogue() as opened:
        assert recordings(opened) == dict.fromkeys(NAMES, "same")
    assert indexed == [NAMES[0]]


def raise_interrupted(*_: object) -> NoReturn:
    raise KeyboardInterrupt


def test_a_cache_that_cannot_be_written_is_one_sentence(
    bucket: FaultyBucket, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(descriptor: int) -> NoReturn:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    said = r"No space left on device: .* or set XDG_CACHE_HOME"
    with pytest.raises(Refused, match=said), catalogue():
        pass


ODD_NAMES = ('it\'s "one"', "büro 机器人", "x*?[1]", " ", "kind=event")


def test_recordings_in_a_bucket_may_have_any_name(bucket: FaultyBucket, made: Path) -> None:
    data = (made / NAMES[0] / f"{NAMES[0]}_0.mcap").read_bytes()
    for name in ODD_NAMES:
        bucket[f"day/{name}/{NAMES[0]}_0.mcap"] = data
        bucket[f"day/{name}.mcap"] = b"no MCAP"
    with catalogue() as opened:
        assert recordings(opened) == dict.fromkeys((*NAMES, *ODD_NAMES), "same")
        assert len(opened.left_out) == len(ODD_NAMES)


@pytest.mark.parametrize("name", ["\x1b[31mred", "new\nline", "..", "a/../../b", "a//b", "."])
def test_a_name_that_leads_elsewhere_is_one_sentence(
    bucket: FaultyBucket, made: Path, tmp_path: Path, name: str
) -> None:
    bucket[f"day/{name}/x.mcap"] = (made / NAMES[0] / f"{NAMES[0]}_0.mcap").read_bytes()
    outside = set(tmp_path.parent.iterdir())
    with pytest.raises(StoreError, match="there has an impossible name") as raised, catalogue():
        pass
    assert str(raised.value).isprintable()
    assert set(tmp_path.parent.iterdir()) == outside


def test_what_is_gone_is_gone_and_what_cannot_be_read_is_named(bucket: FaultyBucket) -> None:
    with catalogue():
        pass
    for key in [key for key in bucket.objects if NAMES[1] in key]:
        del bucket.objects[key]
    bucket["day/broken/broken_0.mcap"] = b"no MCAP"
    with catalogue() as opened:
        assert recordings(opened) == {NAMES[0]: "same"}
        (said,) = opened.left_out
    assert said.startswith("broken is left out: ")
    assert len(list(opened.path.parent.iterdir())) == 2


def test_five_percent_of_failing_requests_do_no_harm_and_a_dead_store_is_named(
    bucket: FaultyBucket,
) -> None:
    bucket.failing_share = bucket.short_share = 0.05
    with catalogue() as opened:
        assert recordings(opened) == dict.fromkeys(NAMES, "same")
    bucket.failing_share = bucket.short_share = 0.0
    bucket.before = lambda *_: 403
    with pytest.raises(StoreError), catalogue():
        pass
