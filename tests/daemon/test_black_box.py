"""The files and clips of the flight recorder: whole, limited, and complete after a clean stop."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from robotctl.check.report import Verdict
from robotctl.check.run import check_recording
from robotctl.daemon.recording import recordings_folder
from robotctl.kernel.patterns import PatternKind
from robotctl.recording import Recorder, RecorderOptions, RecorderStats, read_info, read_messages
from robotctl.recording.format.journal import EntryKind, decode
from robotctl.ros.nodes.velocity_publisher import VelocityPublisher
from tests.support.bags import text
from tests.support.recordings import read_strictly
from tests.support.waiting import loop_until, until
from tests.support.world import (
    PATIENT,
    InProcess,
    NewPeer,
    Peer,
    World,
    journal_of,
    new_world,
)

MARK = "the door \x1b[2J opened"
LATCHED = ("/robot_status", "/rosout")
CLIPS = "recording.clip_before_s: 2.0\nrecording.clip_after_s: 0.5\n"
CONFIG = PATIENT.replace("recording.clip_before_s: 0.0\n", CLIPS)


class Flight:
    """The observations of one run of the daemon."""

    def __init__(self, world: World, peer: Peer) -> None:
        """Drive, mark, split, fail and stop."""
        subprocess.run(["git", "init", "-q"], cwd=world.folder, check=True)
        world.ok("start", "--sim", settings=CONFIG)
        peer("listen")
        until(lambda: world.ok("mark", "does anybody hear?") and peer("heard")["marks"])
        world.ok("drive", "circle")
        until(lambda: world.status()["velocity"]["linear"] > 0.05)
        self.marked = world.answer("mark", MARK)
        until(lambda: any(MARK in each for each in peer("heard")["marks"]))
        world.ok("record", "split")
        until(lambda: world.status()["velocity"]["linear"] > 0.05)
        world.ok("set-mode", "error")
        until(lambda: "clip of the error" in world.log())
        for command in (("record", "status"), ("recordings",)):
            world.ok(*command)
        world.ok("estop")
        self.refused = [world.robotctl("mark", words) for words in ("x" * 1001, " ")]
        self.heard = peer("heard")["marks"]
        world.ok("stop")
        self.refused += [world.robotctl(*each) for each in (("mark", "x"), ("record", "split"))]
        self.ended = world.answer("info", "last")
        self.folder = world.recording
        self.log = world.log()

    @property
    def files(self) -> list[Path]:
        """The files of the recording in their order."""
        return sorted(self.folder.glob("*.mcap"))

    @property
    def clips(self) -> list[Path]:
        """The clips in the order of their events."""
        return sorted((self.folder / "clips").iterdir(), key=event_ns)


def event_ns(clip: Path) -> int:
    return int(read_info(clip).metadata["robotctl.clip"]["event_ns"])


@pytest.fixture(scope="module")
def flight() -> Iterator[Flight]:
    with new_world() as world, Peer(world) as peer:
        yield Flight(world, peer)


def test_every_file_of_a_split_recording_stands_alone(flight: Flight) -> None:
    assert len(flight.files) == 2
    for path in flight.files:
        stored = read_strictly(path)
        assert [m.data for m in sorted(stored, key=lambda m: m.log_ns)] == [
            m.data for m in read_messages(path)
        ]
        with AnyReader([path]) as bag:
            assert bag.message_count == len(stored)
        assert any(message.topic == "/robot_status" for message in stored)
        report = check_recording(path)
        assert (report.verdict, report.missing) == (Verdict.SAME, [])
        assert report.events > 10
    assert check_recording(flight.folder).verdict is Verdict.SAME


def test_each_file_names_the_software_that_made_it(flight: Flight) -> None:
    modes = []
    for path in flight.files:
        with path.open("rb") as stream:
            (info,) = (
                each.metadata
                for each in make_reader(stream).iter_metadata()
                if each.name == "robotctl"
            )
        modes.append(info["mode"])
        names = ("robot", "host", "robotctl", "python", "rclpy", "ros_distro", "rmw", "mcap")
        assert all(info[name] for name in names)
        assert info["parameter.recording.clip_before_s"] == "2.0"
        assert info["directory"] == str(flight.folder.parents[1])
        assert "git.directory" not in info  # a repository without a commit
    assert modes == ["IDLE", "MOVING"]


def test_the_ledger_is_in_the_file_and_accounts_for_every_message(flight: Flight) -> None:
    ledger = flight.ended["ledger"]
    assert {"/cmd_vel", "/odom", "/robot_status", "/robotctl/journal"} <= set(ledger)
    for topic in flight.ended["topics"]:
        counts = ledger[topic["name"]]
        assert counts["received"] == counts["written"] + counts["dropped"]
        assert (counts["queued"], counts["dropped"]) == (0, 0)
        repeated = topic["count"] - counts["written"]  # latched messages, in the second file
        assert repeated in ((0, 1) if topic["name"] in LATCHED else (0,)), topic["name"]


def test_a_mark_is_recorded_published_and_named_with_its_source(flight: Flight) -> None:
    *_, message = read_messages(flight.folder, {"/robotctl/marks"})
    *_, event = (each for each in flight.ended["events"] if each["kind"] == "mark")
    assert message.log_ns == event["time_ns"] == flight.marked["time_ns"]
    assert message.data.rstrip(b"\0") == text(event["text"]).rstrip(b"\0")
    assert event["text"].startswith(f"{MARK} [robotctl mark (uid {os.getuid()}, pid ")
    assert flight.heard[-1] == event["text"]
    assert "\x1b" not in flight.log


def test_a_mark_that_is_none_and_one_without_a_daemon_are_refused(flight: Flight) -> None:
    assert [ran.exit_code for ran in flight.refused] == [2, 2, 3, 3]
    assert "a mark has 1 to 1000 characters, not 1001" in flight.refused[0].err
    assert all(ran.err.count("\n") == 1 and not ran.out for ran in flight.refused)


def test_each_error_and_emergency_stop_has_a_clip(flight: Flight) -> None:
    infos = [read_info(path) for path in flight.clips]
    about = [info.metadata["robotctl.clip"] for info in infos]
    assert [each["event"] for each in about] == ["error", "estop"]
    events = [each for each in flight.ended["events"] if each["kind"] in ("error", "estop")]
    assert [each["event_ns"] for each in about] == [str(each["time_ns"]) for each in events]
    for each in about:
        assert int(each["start_ns"]) >= int(each["event_ns"]) - 2_000_000_000
    assert int(about[0]["end_ns"]) == int(about[0]["event_ns"]) + 500_000_000


def test_a_clip_is_whole_and_decided_again(flight: Flight) -> None:
    for path in flight.clips:
        assert {"/cmd_vel", "/odom", "/robot_status"} <= {m.topic for m in read_strictly(path)}
        report = check_recording(path)
        assert (report.verdict, report.missing, report.notes) == (Verdict.SAME, [], [])


def test_clips_are_no_part_of_the_bag(flight: Flight) -> None:
    with AnyReader([flight.folder]) as bag:
        assert bag.message_count == read_info(flight.folder).message_count
    metadata = (flight.folder / "metadata.yaml").read_text()
    assert "clips" not in metadata


@pytest.fixture
def short_files(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make each chunk fill a file."""
    options = partial(RecorderOptions, split_bytes=1)
    monkeypatch.setattr(recordings_folder, "RecorderOptions", options)


def files_of(world: World) -> list[Path]:
    return sorted(world.recordings.glob("*/*.mcap"), key=number_of)


def number_of(path: Path) -> int:
    return int(path.stem.rpartition("_")[2])


@pytest.mark.usefixtures("short_files")
async def test_each_file_begins_with_a_snapshot_and_can_be_decided_again(
    in_process: InProcess, world: World
) -> None:
    async with in_process(drive=PatternKind.CIRCLE) as daemon:
        await loop_until(lambda: len(files_of(world)) > 5)
        for _ in range(3):
            await daemon.ask("record_split")
    seqs = []
    for path in files_of(world):
        entries = [decode(m.data) for m in read_messages(path, {"/robotctl/journal"})]
        assert entries[0].kind is EntryKind.SNAPSHOT
        seqs += [entry.seq for entry in entries]
        report = check_recording(path)
        assert report.verdict is Verdict.SAME
        assert not any("before the first snapshot" in note for note in report.notes)
    assert seqs == list(range(len(seqs)))


SLOW_DISK_S = 0.3
"""How long the close of a recording takes here; meanwhile the peer sends 15 samples."""

Closed = list[RecorderStats]


@pytest.fixture
def closed(monkeypatch: pytest.MonkeyPatch) -> Closed:
    """The stats of each recorder, some time after its close."""
    said: Closed = []

    class ClosedSlowly(Recorder):
        def close(self) -> RecorderStats:
            super().close()
            time.sleep(SLOW_DISK_S)
            said.append(self.stats())
            return said[-1]

    monkeypatch.setattr(recordings_folder, "Recorder", ClosedSlowly)
    return said


@pytest.mark.parametrize("observe", [False, True])
async def test_nothing_is_received_any_more_when_the_recording_is_finished(
    in_process: InProcess, world: World, new_peer: NewPeer, closed: Closed, observe: bool
) -> None:
    peer = new_peer(world)
    peer("be_a_robot")
    peer("take_commands", kind="Twist")
    async with in_process(observe=observe, sim=None if observe else False) as daemon:
        await daemon.until(lambda status: count(status, "/odom") > 20)
    assert [(stats.dropped, stats.queued) for stats in closed] == [(0, 0)]


def count(status: Any, topic: str) -> int:
    return sum(each["count"] for each in status["topics"] if each["name"] == topic)


async def test_a_file_that_is_full_at_the_end_is_followed_by_none(
    in_process: InProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: Closed = []

    class FullAtEnd(Recorder):
        def __init__(self, *given: Any, on_full: Callable[[Path], None], **options: Any) -> None:
            super().__init__(*given, on_full=on_full, **options)
            self.tell_full = on_full

        def close(self) -> RecorderStats:
            """Report a full file at the close; the loop gets the call after it."""
            stats = super().close()
            self.tell_full(stats.file)
            time.sleep(SLOW_DISK_S)
            said.append(self.stats())
            return stats

    monkeypatch.setattr(recordings_folder, "Recorder", FullAtEnd)
    async with in_process():
        pass
    assert [stats.dropped for stats in said] == [0]


async def test_the_publisher_stays_until_the_last_zero_is_acknowledged(
    in_process: InProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    published: list[int] = []

    def acknowledged(velocity: VelocityPublisher) -> bool:
        published.append(velocity.published)
        return len(published) > 3

    monkeypatch.setattr(VelocityPublisher, "is_acknowledged", acknowledged)
    async with in_process():
        pass
    assert len(published) == 4
    assert len(set(published)) == 1, "a command was sent after it"


@pytest.mark.slow
def test_a_hundred_clean_stops_lose_no_entry(world: World) -> None:
    for _ in range(100):
        world.ok("start", "--sim", "--config", str(world.patient))
        world.ok("stop")
        assert ", 0 dropped, 0 lost" in world.log()
    for folder in world.recordings.iterdir():
        journal = journal_of(folder)
        assert [entry.seq for entry in journal] == list(range(len(journal)))
