"""Tidying, indexes and clips: no part of the daemon waits for them, or fails with them."""

from __future__ import annotations

import asyncio
import json
import logging
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from fcntl import LOCK_EX, flock
from pathlib import Path
from typing import Any

import pytest

from robotctl.base.processes import start
from robotctl.collection.catalogue import stamps_in
from robotctl.collection.index_file import files_of, index_path, stamp_of
from robotctl.config import RecordingParams
from robotctl.daemon.recording import housekeeping as module
from robotctl.daemon.recording.black_box import DEFAULT_LIMITS, BlackBox, ClipLimits, clip_command
from robotctl.daemon.recording.housekeeping import TIDY, Indexer, has_grown
from robotctl.kernel.constants import NS_PER_S
from robotctl.recording import Recorder, read_info
from robotctl.recording.format.names import EventKind
from robotctl.recording.format.recorded_events import RecordedEvent
from robotctl.recording.keep.clip import ClipJob, Moment
from robotctl.recording.keep.retention import RetentionPolicy, enforce_retention
from robotctl.testing.drives import GID, TWIST
from tests.support.recordings import numbered, recorded
from tests.support.waiting import DEADLINE_S, loop_until, until
from tests.support.world import PATIENT, InProcess, World

_listeners: list[Callable[[str], None]] = []


def _hear(event: str, arguments: tuple[Any, ...]) -> None:
    if event == "open" and isinstance(arguments[0], str | bytes | os.PathLike):
        for listener in _listeners:
            listener(os.fsdecode(arguments[0]))


@contextmanager
def opened_below(folder: Path) -> Iterator[list[Path]]:
    """The files that this process opens in a folder."""
    found: list[Path] = []

    def listen(name: str) -> None:
        if Path(name).is_relative_to(folder):
            found.append(Path(name))

    if not _listeners:
        sys.addaudithook(_hear)  # an audit hook cannot be removed
    _listeners.append(listen)
    try:
        yield found
    finally:
        _listeners[:] = [lambda name: None]


def torn(folder: Path) -> Path:
    """A recording without its end, as a crash leaves it."""
    file = recorded(folder, 100)
    os.truncate(file, file.stat().st_size - 20)
    return file


@contextmanager
def tidied_by_somebody(recordings: Path) -> Iterator[None]:
    """Another daemon that tidies the folder slowly."""
    folder = os.open(recordings, os.O_RDONLY)
    try:
        flock(folder, LOCK_EX)
        yield
    finally:
        os.close(folder)


def at_work(world: World, job: str) -> list[int]:
    """Return the processes that tidy or index."""
    return [pid for pid, command in world.processes().items() if job in command]


async def test_no_file_there_is_opened_before_ready(in_process: InProcess, world: World) -> None:
    files = [torn(world.recordings / f"robot_{number}") for number in range(5)]
    (world.recordings / "README").write_text("somebody's")
    with opened_below(world.recordings) as opened:
        async with in_process() as daemon:
            status = await daemon.ask("status")
            own = Path(status["recorder"]["file"]).parent
            assert own / status["recorder"]["file"] in opened
            assert {path for path in opened if not path.is_relative_to(own)} <= {world.recordings}
            await daemon.until(lambda status: str(status["warnings"]).count("torn") == len(files))
    assert [read_info(file).missing for file in files] == [()] * len(files)


def test_what_is_lost_is_in_the_status_and_what_is_well_in_the_log_only(world: World) -> None:
    file = torn(world.recordings / "robot_1")
    hopeless = torn(world.recordings / "robot_2")
    os.truncate(hopeless, 100)
    old = torn(world.recordings / "robot_0")
    os.utime(old, (0, 0))
    world.ok("start", "--sim")
    until(lambda: len(world.status()["warnings"]) >= 2)
    warnings = "\n".join(world.status()["warnings"])
    assert f"repaired: {file.name} was torn: " in warnings
    assert f"{hopeless.name} was torn and cannot be repaired" in warnings
    assert "removed" not in warnings
    assert f"removed for its age or to free space: {old}" in world.log()
    assert not old.exists()
    world.ok("stop")
    (journal,) = (world.folder / "state" / "robotctl" / "robot" / "decisions").iterdir()
    removed = [line for line in journal.read_text().splitlines() if '"kind":"removed"' in line]
    assert [json.loads(line)["file"] for line in removed] == [str(old)]


def test_start_split_and_stop_do_not_wait_for_another_process_that_tidies(world: World) -> None:
    file = torn(world.recordings / "robot_1")
    size = file.stat().st_size
    with tidied_by_somebody(world.recordings):
        world.ok("start", "--sim")
        until(lambda: at_work(world, TIDY))
        until(lambda: world.status()["recorder"]["written"] > 100)
        world.ok("record", "split")
        world.ok("stop")
        assert at_work(world, TIDY) == []
        assert file.stat().st_size == size
    assert "could not be tidied" not in world.log()


pytest.importorskip("duckdb", reason="indexes are an extra: robotctl[parquet]")


def test_each_closed_file_and_the_closed_recording_are_indexed_beside_it(world: World) -> None:
    """The last process outlives the daemon, and ends."""
    world.patient.write_text(PATIENT.replace("index: false", "index: true"))
    world.ok("start", "--sim", "--drive", "square")
    recording = Path(world.status()["recorder"]["file"]).parent
    until(lambda: world.status()["recorder"]["written"] > 100)
    assert at_work(world, TIDY) == [], "a folder without other recordings costs no process"
    world.ok("record", "split")
    until(index_path(recording).exists)
    (first,) = sorted(recording.glob("*.mcap"))[:1]
    assert stamps_in(index_path(recording)) == {recording.name: stamp_of([first])}
    until(lambda: not at_work(world, module.INDEX))
    world.ok("stop")
    complete = {recording.name: stamp_of(files_of(recording))}
    until(lambda: stamps_in(index_path(recording)) == complete)
    until(lambda: not at_work(world, module.INDEX))
    assert not list(recording.glob(".*"))
    enforce_retention(world.recordings, RetentionPolicy(max_bytes=1), 0.0)
    assert not recording.exists()


MakeIndexer = Callable[[str], Indexer]


@pytest.fixture
def indexed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> MakeIndexer:
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
    indexed: MakeIndexer, script: str, failure: str
) -> None:
    indexer = indexed(script)
    assert indexer.problem == ""
    running = asyncio.create_task(indexer.run())
    for times in ("once", "2 times"):
        for _ in range(2):
            indexer.file_finished()
        await loop_until(lambda: indexer.problem == f"indexing failed {times}: {failure}")  # noqa: B023
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
    indexed: MakeIndexer, tmp_path: Path
) -> None:
    go_on = tmp_path / "go on"
    os.mkfifo(go_on)
    wait = f"import sys; open({str(go_on)!r}).read(); sys.stderr.write('not indexed')"
    await indexed(wait).finish()
    log = tmp_path / "daemon.log"
    assert log.read_text() == ""
    await asyncio.to_thread(go_on.write_text, "now")
    await loop_until(lambda: log.read_text() == "not indexed")


async def test_a_cancelled_indexer_leaves_no_process(indexed: MakeIndexer, tmp_path: Path) -> None:
    pid = tmp_path / "pid"
    lasting = f"import os, time; open({str(pid)!r}, 'w').write(str(os.getpid())); time.sleep(600)"
    indexer = indexed(lasting)
    running = asyncio.create_task(indexer.run())
    indexer.file_finished()
    await loop_until(lambda: pid.exists() and pid.read_text())
    running.cancel()
    await asyncio.wait({running})
    with pytest.raises(ProcessLookupError):
        os.kill(int(pid.read_text()), 0)


SAY = """
import os, sys
def say(text):
    os.write(int(sys.argv[-1]), f"{text}\\n".encode())
"""

NOW = RecordedEvent(EventKind.ERROR, 0, "because")
PARAMS = RecordingParams(clip_before_s=1.0, clip_after_s=0.0)
WRITE = "log.write('cut\\n')"

Log = Callable[[], str]
Cutter = Callable[[str], tuple[str, ...]]


@pytest.fixture
def clip_log(tmp_path: Path) -> Log:
    """Return what the programs in the place of the clip process have written so far."""
    path = tmp_path / "log"
    return lambda: path.read_text() if path.exists() else ""


@pytest.fixture
def cutter(tmp_path: Path) -> Cutter:
    """Return the command of a Python program that takes the place of the clip process."""
    return lambda program: (
        sys.executable,
        "-c",
        f"log = open({str(tmp_path / 'log')!r}, 'a')\n{SAY}{program}",
    )


async def cut(
    cutter: tuple[str, ...],
    *events: RecordedEvent,
    params: RecordingParams = PARAMS,
    limits: ClipLimits = DEFAULT_LIMITS,
) -> None:
    box = BlackBox(params, Path("/nowhere"), command=lambda job: cutter, limits=limits)
    for event in events:
        box.note(event)
    await box.finish()


@pytest.mark.parametrize(
    ("program", "said"),
    [
        ('say(\'{"error": "the disk is full"}\')', "the disk is full"),
        ("raise SystemExit('it broke')", "its process ended with 1"),
        ("say('[1]')", "no clip was cut of the error"),
        ('say(\'{"target": "a.mcap", "lost": ["a chunk"]}\')', "the clip is incomplete: a chunk"),
    ],
)
async def test_a_failed_clip_process_is_only_logged(
    program: str, said: str, cutter: Cutter, caplog: pytest.LogCaptureFixture
) -> None:
    await cut(cutter(program), NOW)
    assert said in caplog.text


async def test_no_clip_is_cut_of_what_is_no_fault_or_where_it_is_switched_off(
    cutter: Cutter, clip_log: Log
) -> None:
    kinds = (EventKind.MARK, EventKind.DRIVE_ENDED)
    await cut(cutter(WRITE), *(RecordedEvent(kind, 0, "") for kind in kinds))
    await cut(cutter(WRITE), NOW, params=RecordingParams(clip_before_s=0.0))
    assert clip_log() == ""
    await cut(cutter(WRITE), NOW)
    assert clip_log() == "cut\n"


async def test_more_than_a_few_waiting_clips_are_refused_and_logged(
    cutter: Cutter, clip_log: Log, caplog: pytest.LogCaptureFixture
) -> None:
    await cut(cutter(WRITE), *[NOW] * 20, limits=ClipLimits(waiting=3))
    assert clip_log().count("cut") == 3
    assert caplog.text.count("the limit is reached") == 17


async def test_each_clip_is_cut_once_when_its_time_is_over(cutter: Cutter, clip_log: Log) -> None:
    params = RecordingParams(clip_before_s=1.0, clip_after_s=600.0)
    slept: list[float] = []

    async def sleep(seconds: float) -> None:
        slept.append(seconds)
        if seconds > 0:
            await asyncio.Event().wait()

    box = BlackBox(
        params,
        Path("/nowhere"),
        command=lambda job: cutter(WRITE),
        now_ns=lambda: 1000 * NS_PER_S,
        sleep=sleep,
    )
    box.note(RecordedEvent(EventKind.ERROR, 0, "1000 s ago"))
    box.note(RecordedEvent(EventKind.EMERGENCY_STOP, 900 * NS_PER_S, "100 s ago"))
    running = asyncio.create_task(box.run())
    await loop_until(lambda: len(slept) == 2)
    assert slept == [-400.0, 500.0]
    assert clip_log() == "cut\n"
    running.cancel()
    await asyncio.wait({running})
    await box.finish()
    assert clip_log() == "cut\ncut\n"


async def test_a_clip_process_that_hangs_is_ended(
    cutter: Cutter, caplog: pytest.LogCaptureFixture
) -> None:
    limits = ClipLimits(end_s=0.2, patience_s=0.2)
    await cut(cutter("import time\ntime.sleep(600)"), NOW, NOW, limits=limits)
    assert "its process took longer than 0 s" in caplog.text
    assert caplog.records[-1].levelno == logging.WARNING


def test_the_clip_process_has_the_lowest_priority(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run", on_failure=pytest.fail)
    moment = Moment(time.time_ns(), EventKind.ERROR)
    job = ClipJob(tmp_path / "run", moment, 1.0, 600.0)
    cutter = start(clip_command(job))
    try:
        until(lambda: os.getpriority(os.PRIO_PROCESS, cutter.pid) == 19)
        now_ns = time.time_ns()
        recorder.write(recorder.add_topic(TWIST), numbered(1), now_ns, now_ns, 1, GID)
        recorder.close()
        said = cutter.receive_one(DEADLINE_S)
    finally:
        recorder.close()
        cutter.close()
    assert said["target"].startswith(str(tmp_path / "run" / "clips"))


async def test_without_duckdb_that_is_said_once_and_nothing_is_started(
    indexed: MakeIndexer,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    indexer = indexed("")
    monkeypatch.setattr(module, "find_spec", lambda name: None)
    monkeypatch.setattr(module, "start", lambda *_, **__: pytest.fail("a process was started"))
    caplog.set_level("INFO")
    for _ in range(2):
        await indexer.finish()
    assert caplog.messages == [module.NOT_INSTALLED]
    assert indexer.problem == ""
