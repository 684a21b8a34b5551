"""The recording is indexed when a file of it is closed; no part of the daemon waits for that."""

from __future__ import annotations

import asyncio
import os
import sys
import threading
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from robotctl.collection.catalogue import stamps_in
from robotctl.collection.index_file import files_of, index_path, stamp_of
from robotctl.daemon.recording import indexer as module
from robotctl.daemon.recording.indexer import Indexer, has_grown
from robotctl.processes import Child, jobs, start
from robotctl.recording.keep.retention import RetentionPolicy, enforce_retention
from tests.support.waiting import until
from tests.support.world import World

pytest.importorskip("duckdb", reason="indexes are an extra: robotctl[parquet]")

Until = Callable[[Callable[[], object]], Awaitable[None]]


def indexing(world: World) -> list[int]:
    found = world.processes().items()
    return [pid for pid, command in found if module.INDEX in command]


def test_each_closed_file_and_the_closed_recording_are_indexed_beside_it(world: World) -> None:
    """The last process outlives the daemon, and ends."""
    world.patient.write_text(world.patient.read_text().replace("index: false", "index: true"))
    world.ok("start", "--sim", "--drive", "square")
    recording = Path(world.status()["recorder"]["file"]).parent
    until(lambda: world.status()["recorder"]["written"] > 100)
    world.ok("record", "split")
    until(index_path(recording).exists)
    (first,) = sorted(recording.glob("*.mcap"))[:1]
    assert stamps_in(index_path(recording)) == {recording.name: stamp_of([first])}
    until(lambda: not indexing(world))
    world.ok("stop")
    complete = {recording.name: stamp_of(files_of(recording))}
    until(lambda: stamps_in(index_path(recording)) == complete)
    until(lambda: not indexing(world))
    assert not list(recording.glob(".*"))
    enforce_retention(world.recordings, RetentionPolicy(max_bytes=1), 0.0)
    assert not recording.exists()


@pytest.fixture
def said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Indexer]:
    """Return a function that makes an indexer whose process runs this Python."""
    (tmp_path / "recording").mkdir()
    (tmp_path / "daemon.log").touch()

    def make(script: str) -> Indexer:
        monkeypatch.setattr(module, "job_command", lambda work, job: (sys.executable, "-c", script))
        return Indexer(tmp_path / "recording", tmp_path / "daemon.log", enabled=True)

    return make


REPORT = 'import os; os.write(3, b\'{"error": "%s"}\\n\')'


@pytest.mark.parametrize(
    ("script", "failure"),
    [
        (REPORT % "the disk is full", "the disk is full"),
        ("import os; os.kill(os.getpid(), 9)", "its process ended with -9"),
        ("import os; os.write(3, b'nothing\\n')", "its process sent an invalid report"),
    ],
)
async def test_a_failure_is_told_and_counted(
    said: Callable[[str], Indexer], until: Until, script: str, failure: str
) -> None:
    indexer = said(script)
    assert indexer.problem == ""
    running = asyncio.create_task(indexer.run())
    for times in ("once", "2 times"):
        for _ in range(2):
            indexer.file_finished()
        await until(lambda: indexer.problem == f"indexing failed {times}: {failure}")  # noqa: B023
    running.cancel()
    await asyncio.wait({running})


def test_all_indexes_of_a_recording_that_goes_on_cost_three_times_the_last() -> None:
    made: list[int] = []
    for files in range(1, 1001):
        if has_grown(files, made[-1] if made else 0):
            made.append(files)
            assert sum(made) <= 3.5 * files
    assert made[:6] == [1, 2, 3, 5, 8, 12]


async def test_the_end_does_not_wait_and_what_goes_wrong_then_is_in_the_log(
    said: Callable[[str], Indexer], until: Until, tmp_path: Path
) -> None:
    go_on = tmp_path / "go on"
    os.mkfifo(go_on)
    wait = f"import sys; open({str(go_on)!r}).read(); sys.stderr.write('not indexed')"
    await said(wait).finish()
    log = tmp_path / "daemon.log"
    assert log.read_text() == ""
    await asyncio.to_thread(go_on.write_text, "now")
    await until(lambda: log.read_text() == "not indexed")


async def test_a_cancelled_indexer_leaves_no_process(
    said: Callable[[str], Indexer], until: Until, tmp_path: Path
) -> None:
    pid = tmp_path / "pid"
    lasting = f"import os, time; open({str(pid)!r}, 'w').write(str(os.getpid())); time.sleep(600)"
    indexer = said(lasting)
    running = asyncio.create_task(indexer.run())
    indexer.file_finished()
    await until(lambda: pid.exists() and pid.read_text())
    running.cancel()
    await asyncio.wait({running})
    with pytest.raises(ProcessLookupError):
        os.kill(int(pid.read_text()), 0)


async def test_nothing_of_it_runs_on_the_loop(
    said: Callable[[str], Indexer], until: Until, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All that opens a file or makes a system call about a process runs in other threads."""
    seen: list[tuple[str, bool]] = []

    def watched(owner: object, name: str) -> None:
        function = getattr(owner, name)

        def call(*arguments: Any, **options: Any) -> Any:
            seen.append((name, threading.current_thread() is threading.main_thread()))
            return function(*arguments, **options)

        monkeypatch.setattr(owner, name, call)

    indexer = said(REPORT % "the disk is full")
    for owner, name in (
        *((module, "start"), (jobs, "start")),
        *((module, "find_spec"), (module, "_size")),
    ):
        watched(owner, name)
    watched(Child, "close")
    running = asyncio.create_task(indexer.run())
    indexer.file_finished()
    await until(lambda: indexer.problem)
    running.cancel()
    await asyncio.wait({running})
    await indexer.finish()
    assert {name for name, _ in seen} == {"start", "find_spec", "_size", "close"}
    assert [name for name, on_loop in seen if on_loop] == []


async def test_an_indexer_that_is_cancelled_while_its_process_starts_leaves_none(
    said: Callable[[str], Indexer], monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, go_on = threading.Event(), threading.Event()
    children: list[Child] = []

    def slow(command: Sequence[str]) -> Child:
        begun.set()
        assert go_on.wait(10)
        children.append(start(command))
        return children[0]

    indexer = said("import time; time.sleep(600)")
    monkeypatch.setattr(jobs, "start", slow)
    running = asyncio.create_task(indexer.run())
    indexer.file_finished()
    assert await asyncio.to_thread(begun.wait, 10)
    running.cancel()
    await asyncio.sleep(0)
    go_on.set()
    await asyncio.wait({running})
    assert running.cancelled()
    with pytest.raises(ProcessLookupError):
        os.kill(children[0].pid, 0)


async def test_without_duckdb_that_is_said_once_and_nothing_is_started(
    said: Callable[[str], Indexer],
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    indexer = said("")
    monkeypatch.setattr(module, "find_spec", lambda name: None)
    monkeypatch.setattr(module, "start", lambda *_, **__: pytest.fail("a process was started"))
    caplog.set_level("INFO")
    for _ in range(2):
        await indexer.finish()
    assert caplog.messages == [module.NOT_INSTALLED]
    assert indexer.problem == ""


async def test_a_huge_recording_is_left_to_those_who_ask(
    said: Callable[[str], Indexer], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    indexer = said("")
    with (tmp_path / "recording" / "recording_0.mcap").open("wb") as file:
        file.truncate(module.MAX_BYTES + 1)
    monkeypatch.setattr(module, "start", lambda *_, **__: pytest.fail("a process was started"))
    await indexer.finish()
