"""The live view of a real daemon, by a client of the protocol, and its events in a recording."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import AsyncExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from websockets.exceptions import InvalidHandshake

from robotctl.messages.definition import parse_definition
from robotctl.messages.fields import parse_path
from robotctl.messages.values import Decoder
from robotctl.recording import JournalEntry
from robotctl.recording.format.noted_events import DEFINITION, TYPE_NAME, encode_event
from robotctl.view.remote_control import LET_GO_S
from tests.support.lines import line_of
from tests.support.view_client import ViewClient, view_client
from tests.support.waiting import DEADLINE_S, until
from tests.support.world import ROBOTCTL, InProcess, World, entries_of, world_with_daemon

LAYOUT = Path(__file__).parents[2] / "docs" / "foxglove-layout.json"


@pytest.fixture(scope="module")
def driving() -> Iterator[World]:
    """A world with a robot that drives."""
    with world_with_daemon("--sim", "--drive", "circle") as world:
        yield world


@contextmanager
def view_of(world: World, *options: str) -> Iterator[tuple[subprocess.Popen[str], dict[str, Any]]]:
    """Run the command during a block; yield the process and what it prints first."""
    process = world.spawn("view", "--port", "0", "--json", *options)
    first = line_of(process.stdout)
    assert first, process.communicate()
    try:
        yield process, json.loads(first)
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            assert process.wait(30) == 130


async def test_every_topic_of_a_robot_is_offered_with_its_type_and_messages(driving: World) -> None:
    with view_of(driving) as (_, ready):
        async with view_client(ready["url"]) as client, view_client(ready["url"]) as second:
            topics = ("/odom", "/cmd_vel", "/robotctl/journal", "/robot_status", "/robotctl/marks")
            await client.subscribe(*topics)
            async with asyncio.timeout(DEADLINE_S):
                while not client.of("/robotctl/marks"):  # nobody hears a mark before it subscribes
                    driving.ok("mark", "seen by the view")
                    await client.receive_for(0.2)
            await client.until(lambda: all(client.of(topic) for topic in topics))
            odometry = decoded(client, "/odom")
            assert odometry["header"]["frame_id"] == "odom"
            await client.until(lambda: decoded(client, "/cmd_vel")["linear"]["x"] > 0.0)
            assert "seen by the view" in str(decoded(client, "/robotctl/marks"))
            layout = json.loads(LAYOUT.read_text())
            await client.until(lambda: layout_topics(layout) <= client.channels.keys())
            check_layout(layout, client)
            for each in (client, second):
                await each.subscribe("/rosout")  # latched
                await each.until(lambda: each.of("/rosout"))  # noqa: B023 - awaited here


def decoded(client: ViewClient, topic: str) -> dict[str, Any]:
    """Return the last message of a topic, decoded by the schema of its offer."""
    channel = client.channels[topic]
    definition = parse_definition(channel["schemaName"], channel["schema"])
    return Decoder(definition).values(client.of(topic)[-1].data)


def message_paths(layout: dict[str, Any]) -> list[str]:
    """Return every path of a message that a panel of the layout shows."""
    configs = layout["configById"].values()
    paths = [path["value"] for config in configs for path in config.get("paths", ())]
    keys = ("topicToRender", "topicPath")
    paths += [config[key] for config in configs for key in keys if key in config]
    return paths + [topic for config in configs for topic in config.get("topics", ())]


def layout_topics(layout: dict[str, Any]) -> set[str]:
    return {path.partition(".")[0] for path in message_paths(layout)}


def check_layout(layout: dict[str, Any], client: ViewClient) -> None:
    """The layout shows each panel that it configures, and fields that exist."""

    def panels(node: Any) -> set[str]:
        return {node} if isinstance(node, str) else panels(node["first"]) | panels(node["second"])

    assert panels(layout["layout"]) == set(layout["configById"])
    for path in message_paths(layout):
        topic, _, field = path.partition(".")
        channel = client.channels[topic]
        definition = parse_definition(channel["schemaName"], channel["schema"])
        if field:
            parse_path(definition, field)


async def test_commands_cannot_be_published_and_a_new_run_has_a_new_token(driving: World) -> None:
    with view_of(driving) as (_, first), view_of(driving) as (_, second):
        assert first["url"].partition("token=")[2] != second["url"].partition("token=")[2]
        stale = f"ws://127.0.0.1:{second['port']}/?{first['url'].partition('?')[2]}"
        with pytest.raises(InvalidHandshake):
            async with view_client(stale):
                pass
        async with view_client(first["url"]) as client:
            await client.until(lambda: client.op("serverInfo"))
            assert client.op("serverInfo")[0]["capabilities"] == []
            await client.offer_twist()
            await client.publish_twist(0.0, 0.0)
            await client.until(lambda: len(client.op("status")) == 2)
    assert driving.status()["mode"] == "MOVING"


async def test_a_view_and_that_of_a_start_end_with_the_daemon(world: World) -> None:
    ready = world.answer("start", "--sim", "--view")
    process = world.spawn("view")
    lines = [line_of(process.stdout) for _ in range(3)]
    assert max(map(len, lines[:2])) <= 81
    for url in (ready["view"]["url"], lines[1].split()[-1]):
        async with view_client(url) as client:
            await client.subscribe("/odom")
            await client.until(lambda: client.of("/odom"))
    world.ok("stop")
    _, err = process.communicate(timeout=60)
    assert process.returncode == 3
    assert err == "robotctl: the daemon of robot 'robot' has ended\n"
    until(lambda: not world.processes())
    assert world.here("start", "--view", "--foreground").exit_code == 2


async def test_a_killed_command_leaves_no_process(driving: World) -> None:
    with view_of(driving) as (process, _):
        (child,) = (pid for pid, line in driving.processes().items() if "robotctl.view" in line)
        os.kill(process.pid, signal.SIGKILL)
        process.wait(30)
        until(lambda: child not in driving.processes())


async def test_with_control_viewers_stop_the_robot_and_move_it_with_a_lease(world: World) -> None:
    world.ok("start", "--sim", "--drive", "circle")
    with view_of(world, "--control") as (_, ready):
        async with view_client(ready["url"]) as client:
            await client.until(lambda: client.op("advertiseServices"))
            assert client.op("serverInfo")[0]["capabilities"] == ["services"]
            await client.offer_twist()
            await client.publish_twist(0.3, 0.0)
            await client.until(lambda: len(client.op("status")) == 2)
            await client.call("/stop", 1)
            await client.until(lambda: client.responses)
            assert client.responses[-1]["success"]
            assert world.status()["mode"] == "IDLE"
            await client.call("/estop", 2)
            await client.until(lambda: len(client.responses) == 2)
            assert client.responses[-1]["success"]
            assert world.status()["mode"] == "EMERGENCY_STOP"
    world.ok("reset")
    await drive_with_the_lease(world)
    world.ok("stop")


async def drive_with_the_lease(world: World) -> None:
    """With the lease a viewer drives until it is silent."""
    process = world.spawn(
        *("lease", "take", "--", ROBOTCTL, "view", "--port", "0", "--json", "--control")
    )
    ready = json.loads(line_of(process.stdout))
    async with view_client(ready["url"]) as client:
        await client.until(lambda: client.op("serverInfo"))
        assert client.op("serverInfo")[0]["capabilities"] == ["services", "clientPublish"]
        await client.offer_twist(encoding="cdr")
        await client.until(lambda: client.op("status"))
        await client.offer_twist()
        await client.publish_twist(0.3, float("nan"))
        await client.until(lambda: len(client.op("status")) == 2)
        assert world.status()["mode"] == "IDLE"
        await driven_until_it_moves(client, world)
        await asyncio.to_thread(until, lambda: world.status()["mode"] == "IDLE")
        await driven_until_it_moves(client, world)
        await driven_through(client, world, "estop")
        await driven_until_told(client)
        assert "let go" in client.op("status")[-1]["message"]
        await driven_through(client, world, "reset")
        await driven_for(client, 0.5)
        assert world.status()["mode"] == "IDLE"  # the operator has not let go
    (view,) = (
        pid
        for pid, line in world.processes().items()
        if " view --port" in line and "lease" not in line
    )
    os.kill(view, signal.SIGINT)  # as Ctrl-C does to all processes of the terminal
    process.wait(60)


async def driven_through(client: ViewClient, world: World, command: str) -> None:
    """Publish a velocity at 40 Hz while a command runs."""
    running = asyncio.create_task(asyncio.to_thread(world.ok, command))
    while not running.done():
        await driven_for(client, 0.1)
    await running


async def driven_until_it_moves(client: ViewClient, world: World) -> None:
    """Publish a velocity at 40 Hz until the robot moves; let go each second, for longer each time.

    On a busy machine this process may be silent for too long, or the view may read too late.
    """
    waiting = asyncio.create_task(
        asyncio.to_thread(until, lambda: world.status()["mode"] == "MOVING")
    )
    pause_s = LET_GO_S + 0.1
    while not waiting.done():
        for _ in range(10):
            if not waiting.done():
                await driven_for(client, 0.1)
        if not waiting.done():
            await client.receive_for(pause_s)
            pause_s *= 1.5
    await waiting


async def driven_until_told(client: ViewClient) -> None:
    """Publish a velocity at 40 Hz until the view says why it does not drive."""
    async with asyncio.timeout(DEADLINE_S):
        while client.op("status")[-1].get("id") != "drive":
            await driven_for(client, 0.1)


async def driven_for(client: ViewClient, seconds: float) -> None:
    """Publish a velocity at 40 Hz for a time."""
    for _ in range(round(seconds * 40)):
        await client.publish_twist(0.2, 0.0)
        await client.receive_for(0.025)


CALM_S = 10.0


@pytest.mark.slow
async def test_a_hundred_stalled_viewers_cost_no_tick_and_little_memory(world: World) -> None:
    """Each has subscribed to every topic, and takes nothing."""
    started = world.answer("start", "--sim", "--drive", "circle")
    with view_of(world) as (_, ready):
        (view,) = (pid for pid, line in world.processes().items() if "robotctl.view" in line)
        calm_ns = time.monotonic_ns()
        await asyncio.sleep(CALM_S)
        stalled_ns = time.monotonic_ns()
        async with AsyncExitStack() as stack:
            clients = [
                await stack.enter_async_context(view_client(ready["url"])) for _ in range(100)
            ]
            before = _resident_bytes(view)
            for client in clients:
                await client.subscribe("/odom", "/cmd_vel", "/robotctl/journal", "/rosout")
                client.socket.transport.pause_reading()
            await asyncio.sleep(2 * CALM_S)
            grown = _resident_bytes(view) - before
            end_ns = time.monotonic_ns()
    assert grown < 64 << 20
    world.ok("stop")
    ticks = [each for each in entries_of(Path(started["recording"])) if each.name == "Tick"]
    if _missed(ticks, calm_ns, stalled_ns):
        pytest.skip("this machine misses ticks without viewers, too")
    assert _missed(ticks, stalled_ns, end_ns) == 0


def _missed(ticks: list[JournalEntry], begin_ns: int, end_ns: int) -> int:
    within = (each for each in ticks if begin_ns <= each.t_ns < end_ns)
    return sum(int(json.loads(each.data)["missed"]) for each in within)


def _resident_bytes(pid: int) -> int:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * 4096


NS = 1_000_000_000


@pytest.mark.parametrize("text", ["", "a", "ab", "abc", "abcd", "ü€", "\udcff"])
def test_an_event_is_what_its_definition_says(text: str) -> None:
    types = get_types_from_msg(DEFINITION, TYPE_NAME)
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    data = encode_event(3 * NS + 5, 4 * NS, {"event": text, "to": "IDLE"})
    event: Any = store.deserialize_cdr(data, TYPE_NAME)
    assert (event.start_time.sec, event.start_time.nanosec) == (3, 5)
    assert (event.end_time.sec, event.end_time.nanosec) == (4, 0)
    shown = text.encode(errors="backslashreplace").decode()
    assert [(pair.key, pair.value) for pair in event.metadata] == [("event", shown), ("to", "IDLE")]


async def test_changes_and_marks_are_events_and_the_recording_is_played_and_checked(
    in_process: InProcess, world: World
) -> None:
    world.patient.write_text(f"{world.patient.read_text()}recording.foxglove_events: true\n")
    async with in_process() as daemon:
        await daemon.ask("set_mode", mode=3, source="a person")
        await daemon.ask("mark", text="a mark", source="a person")
    stop = {"event": "mode", "from": "IDLE", "to": "EMERGENCY_STOP"}
    stop |= {"reason": "requested by a person", "cause": "operator stop"}
    mark = {"event": "mark", "text": "a mark", "by": "a person"}
    assert [dict(pairs) for pairs in events_of(world.recording)] == [stop, mark]
    played = world.here("replay", str(world.recording), "--rate", "max", "--json")
    assert "/robotctl/events" in played.out


def events_of(folder: Path) -> list[list[tuple[str, str]]]:
    with AnyReader([folder]) as reader:
        (connection,) = (each for each in reader.connections if each.msgtype == TYPE_NAME)
        assert connection.topic == "/robotctl/events"
        events: list[Any] = [
            reader.deserialize(data, each.msgtype)
            for each, _, data in reader.messages([connection])
        ]
    return [[(pair.key, pair.value) for pair in event.metadata] for event in events]
