"""Each failure in the daemon ends in zero velocity, and is reported."""

from __future__ import annotations

import asyncio
import itertools
import json
import os
import re
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from shutil import rmtree
from typing import Any

import pytest

from robotctl.base.errors import Refused, RobotctlError
from robotctl.check.compare import first_divergence
from robotctl.daemon.app import serve
from robotctl.daemon.command_line import DaemonOptions
from robotctl.daemon.control.control_loop import Watchdog
from robotctl.daemon.control.inputs import Inputs
from robotctl.daemon.control.robot_report import RobotReport
from robotctl.daemon.recording.recorder_report import RecorderReport
from robotctl.daemon.supervisor import OUT_OF_MEMORY
from robotctl.ipc.client import Client
from robotctl.ipc.listener import Listener
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.patterns import PatternKind
from robotctl.kernel.types import ModeRequested
from robotctl.recording import read_info
from robotctl.ros.nodes.simulated_robot import SimulatedRobot
from robotctl.ros.nodes.velocity_publisher import VelocityPublisher
from robotctl.ros.tap.tap import Tap
from tests.daemon.conftest import is_moving
from tests.support.waiting import loop_until, until
from tests.support.world import InProcess, NewPeer, World, journal_of, read_back


class Bomb:
    """Replaces a method, and raises once when armed."""

    def __init__(self, patch: pytest.MonkeyPatch, owner: Any, name: str) -> None:
        self.armed = False
        original = getattr(owner, name)

        def passed(*args: Any, **kwargs: Any) -> Any:
            if self.armed:
                self.armed = False
                raise RuntimeError("injected")
            return original(*args, **kwargs)

        patch.setattr(owner, name, passed)


async def ticks(daemon: Any, more: int) -> Any:
    """Wait until that many more commands were sent; return the status then."""
    before = commands_in(await daemon.ask("status"))
    return await daemon.until(lambda status: commands_in(status) > before + more)


def commands_in(status: Any) -> int:
    return int(next(each["count"] for each in status["topics"] if each["name"] == "/cmd_vel"))


def commands(world: World) -> list[tuple[float, float]]:
    """Every recorded velocity command."""
    from geometry_msgs.msg import Twist
    from rclpy.serialization import deserialize_message

    messages = read_back(world.recording)["/cmd_vel"]
    twists = [deserialize_message(message.data, Twist) for message in messages]
    return [(twist.linear.x, twist.angular.z) for twist in twists]


@pytest.mark.parametrize(
    ("owner", "name", "said"),
    [
        (Watchdog, "ping", "the control task failed"),
        (Tap, "_look", "the recorder task failed"),
        (Listener, "accept", "the socket task failed"),
        (Inputs, "odometry", "the callback of "),
        (VelocityPublisher, "publish", "PublishTwist failed"),
    ],
)
async def test_a_part_that_raises_stops_the_robot_and_comes_back(
    in_process: InProcess,
    world: World,
    monkeypatch: pytest.MonkeyPatch,
    owner: Any,
    name: str,
    said: str,
) -> None:
    bomb = Bomb(monkeypatch, owner, name)
    async with in_process(drive=PatternKind.CIRCLE) as daemon:
        await daemon.until(is_moving)
        bomb.armed = True
        status = await daemon.until(lambda status: status["mode"] == "ERROR")
        assert said in status["mode_reason"]
        assert "injected" in status["mode_reason"]
        await ticks(daemon, 20)
    driven = commands(world)
    assert driven[-20:] == 20 * [(0.0, 0.0)]
    assert max(driven)[0] > 0.02


async def test_a_simulator_that_dies_stops_the_robot(
    in_process: InProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    original = SimulatedRobot.run
    died = asyncio.Event()

    async def run(robot: SimulatedRobot) -> None:
        alive = asyncio.create_task(original(robot))
        await died.wait()
        alive.cancel()
        died.clear()
        raise RuntimeError("injected")

    monkeypatch.setattr(SimulatedRobot, "run", run)
    async with in_process(drive=PatternKind.CIRCLE) as daemon:
        await daemon.until(is_moving)
        died.set()
        status = await daemon.until(lambda status: status["mode"] == "ERROR")
        assert "the simulated robot task failed" in status["mode_reason"]


async def test_an_exception_that_only_the_loop_sees_stops_the_robot(
    in_process: InProcess, tmp_path: Path
) -> None:
    def fail() -> None:
        raise RuntimeError("injected")

    config = tmp_path / "config.yaml"
    config.write_text("fifo_priority: 10\n")
    async with in_process(config=config) as daemon:
        asyncio.get_running_loop().call_soon(fail)
        status = await daemon.until(lambda status: status["mode"] == "ERROR")
        assert "RuntimeError: injected" in status["mode_reason"]
        told = status["scheduling"]  # the one that was granted
        granted = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO
    assert told == "SCHED_FIFO 10" if granted else told.startswith("SCHED_OTHER (SCHED_FIFO 10")


async def test_a_daemon_that_no_client_finds_stops_the_robot_until_its_socket_is_back(
    in_process: InProcess, world: World
) -> None:
    folder = world.folder / "run" / "robotctl"
    async with in_process(drive=PatternKind.CIRCLE) as daemon:
        await daemon.until(is_moving)
        with Client("robot") as client:  # connected before the failure
            folder.rename(world.folder / "removed")
            folder.write_text("of another user")

            def says_so() -> bool:
                reason = client.call("status")["mode_reason"]
                return f"no client can reach this daemon: {folder} is not a folder" in reason

            await asyncio.to_thread(until, says_so)
            assert (await asyncio.to_thread(client.call, "status"))["mode"] == "ERROR"
        folder.unlink()
        status = await daemon.until(lambda status: status["warnings"])
        assert any("was removed or replaced once" in text for text in status["warnings"])
        assert (await daemon.ask("reset", source="test"))["mode"] == "IDLE"
    assert commands(world)[-20:] == 20 * [(0.0, 0.0)]


async def test_what_could_not_be_done_is_not_confirmed(
    in_process: InProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    bomb = Bomb(monkeypatch, VelocityPublisher, "publish")
    async with in_process() as daemon:
        step = Kernel.step

        def arm(kernel: Kernel, event: Any) -> Any:
            bomb.armed = isinstance(event, ModeRequested)
            return step(kernel, event)

        monkeypatch.setattr(Kernel, "step", arm)
        with pytest.raises(Refused, match=r"EMERGENCY_STOP, but PublishTwist failed: injected"):
            await daemon.ask("set_mode", mode=3, source="test")


async def test_a_daemon_that_is_cancelled_while_moving_ends_with_zero(
    in_process: InProcess, world: World
) -> None:
    async def drive() -> None:
        async with in_process(drive=PatternKind.CIRCLE) as daemon:
            await daemon.until(is_moving)
            raise LookupError  # then the fixture cancels the daemon

    with pytest.raises(LookupError):
        await drive()
    driven = commands(world)
    assert driven[-1] == (0.0, 0.0)
    assert max(driven)[0] > 0.02
    assert world.sockets() == []


async def test_a_start_that_is_cancelled_at_any_point_leaves_nothing_open(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    world.enter(monkeypatch)
    options = DaemonOptions("robot", None, world.recordings, None, True, world.domain_id)
    ready = asyncio.Event()
    files = len(os.listdir("/proc/self/fd"))
    for turns in itertools.chain(range(0, 20, 4), itertools.count(20, 40)):
        with ExitStack() as at_end:
            starting = asyncio.create_task(serve(options, [], lambda _: ready.set(), at_end))
            for _ in range(turns):
                await asyncio.sleep(0)
            starting.cancel()
            with pytest.raises(asyncio.CancelledError):
                await starting
        assert world.sockets() == []
        if ready.is_set() or turns > 300:
            break
    assert len(os.listdir("/proc/self/fd")) <= files + 8
    for folder in world.recordings.glob("*"):
        assert read_info(folder).missing == ()


async def test_a_wall_clock_that_is_set_does_not_touch_the_drive(
    in_process: InProcess, world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    wall_ns = time.time_ns
    async with in_process(drive=PatternKind.CIRCLE) as daemon:
        await daemon.until(is_moving)
        for jump_s in (-3600, 3600):
            shift_ns = jump_s * 1_000_000_000
            monkeypatch.setattr(time, "time_ns", lambda shift_ns=shift_ns: wall_ns() + shift_ns)
            assert (await ticks(daemon, 25))["mode"] == "MOVING"
    journal = journal_of(world.recording)
    assert [entry.name for entry in journal].count("ModeChanged") == 2  # began and ended
    assert first_divergence(journal) is None
    # Only Python's clock was set, and not that of the received messages: no check takes that.
    rmtree(world.recording)


def sleep(seconds: float) -> None:
    time.sleep(seconds)


def spin(seconds: float) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        pass


STALL_S = 1.1


@pytest.mark.parametrize("stall", [sleep, spin])
async def test_others_see_zero_while_the_loop_stalls(
    in_process: InProcess, world: World, new_peer: NewPeer, stall: Callable[[float], None]
) -> None:
    peer = await asyncio.to_thread(new_peer, world)
    await asyncio.to_thread(peer, "listen")
    async with in_process(config=None, drive=PatternKind.CIRCLE) as daemon:
        await daemon.until(is_moving)
        await asyncio.to_thread(until, lambda: peer("heard")["commands"])
        begun_ns = time.monotonic_ns()
        stall(STALL_S)
        ended_ns = time.monotonic_ns()
        status = await daemon.until(lambda status: status["mode"] == "ERROR")
        held = rf"in {stall.__name__} \(test_faults.py:|the machine was busy: no processor for "
        reason = status["mode_reason"]
        assert re.match(rf"the control loop stalled for 1\.\d+ s \(({held})", reason)
        answer = await daemon.ask("reset", source="test")
        assert answer["mode"] == "IDLE"
        heard = (await asyncio.to_thread(peer, "heard"))["commands"]
    during = [
        (linear, angular) for _, seen_ns, linear, angular in heard if begun_ns < seen_ns < ended_ns
    ]
    assert during.count((0.0, 0.0)) > 3
    first = during.index((0.0, 0.0))
    assert set(during[first:]) == {(0.0, 0.0)}
    after = [(linear, angular) for _, seen_ns, linear, angular in heard if seen_ns >= ended_ns]
    assert set(after) <= {(0.0, 0.0)}


async def test_a_stall_while_standing_is_counted_and_logged_and_needs_no_reset(
    in_process: InProcess, world: World, caplog: pytest.LogCaptureFixture
) -> None:
    async with in_process(config=None) as daemon:
        sleep(STALL_S)
        status = await daemon.until(lambda status: status["stalls"] == 1)
        assert status["mode"] == "IDLE"
        assert any("stalls of the control loop: 1," in each for each in status["warnings"])
        await ticks(daemon, 5)
        answer = await daemon.ask("set_mode", mode=1, source="test")
        assert answer["mode"] == "MOVING"  # the gate is open again
        await daemon.until(is_moving)
    assert "the loop stalled for 1." in caplog.text
    assert "in sleep (test_faults.py" in caplog.text
    assert max(commands(world))[0] > 0.02


async def test_after_a_short_stall_the_robot_drives_on_from_zero(
    in_process: InProcess, world: World
) -> None:
    async with in_process(drive=PatternKind.CIRCLE) as daemon:
        await daemon.until(is_moving)
        sleep(0.4)  # the patient configuration allows 5 s
        status = await daemon.until(lambda status: status["stalls"] >= 1)
        assert status["mode"] == "MOVING"
        await ticks(daemon, 20)
    journal = journal_of(world.recording)
    (stall, *_) = [json.loads(e.data) for e in journal if e.name == "LoopStalled"]
    assert stall["zeros"] > 3
    driven = commands(world)
    began = next(number for number, each in enumerate(driven) if each != (0.0, 0.0))
    stalled = driven.index((0.0, 0.0), began)
    went_on = next(each for each in driven[stalled:] if each != (0.0, 0.0))
    assert went_on[0] <= 0.05
    assert first_divergence(journal) is None


def test_a_simulated_fault_stops_the_robot_and_is_marked_in_the_recording(world: World) -> None:
    world.ok("start", "--sim", "--drive", "circle")
    told = world.answer("sim", "fault", "brownout", "--for", "1s")
    assert told["mode"] == "EMERGENCY_STOP"
    assert told["stopped_after_ms"] > 0.0
    assert "the battery is at 10%" in told["message"]
    assert "did not move" in world.ok("sim", "fault", "slip", "--for", "100ms")
    world.ok("sim", "set", "battery=0.5")
    world.robotctl("sim", "fault", "slip", "--for", "2h", "--json").failed(2, out='"usage"')
    assert world.robotctl("sim", "set", "battery=2").exit_code == 2
    world.ok("stop")
    events = world.answer("info", "last")["events"]
    marks = [each["text"] for each in events if each["kind"] == "mark"]
    assert marks[0].startswith("simulated fault: brownout for 1 s")


@pytest.mark.parametrize(
    ("owner", "name"),
    [
        (RecorderReport, "sample"),  # a task
        (Inputs, "odometry"),  # a callback of ROS
        (VelocityPublisher, "publish"),  # an effect of the kernel
        (RobotReport, "path"),  # a request
    ],
)
async def test_without_memory_the_robot_stops_and_the_daemon_ends(
    in_process: InProcess,
    world: World,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    owner: Any,
    name: str,
) -> None:
    original, armed = getattr(owner, name), [False]
    failed: list[str] = []

    def fail(*args: Any, **kwargs: Any) -> Any:
        if armed[0] and len(failed) < 5:
            failed.append(name)
            raise MemoryError
        return original(*args, **kwargs)

    async def drive() -> None:
        async with in_process(drive=PatternKind.CIRCLE) as daemon:
            await daemon.until(lambda status: status["mode"] == "MOVING")
            armed[0] = True
            with suppress(RobotctlError):
                await daemon.ask("path")
            await loop_until(lambda: failed)

    monkeypatch.setattr(owner, name, fail)
    with pytest.raises(RobotctlError, match=OUT_OF_MEMORY):
        await drive()
    assert commands(world)[-1] == (0.0, 0.0)
    assert caplog.text.count("out of memory") < 5
    assert "Traceback" not in caplog.text
