"""The live view of a real daemon, by a client of the protocol."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed, InvalidHandshake

from robotctl.cdr.definition import parse_definition
from robotctl.cdr.field_path import parse_path
from robotctl.cdr.values import decode
from tests.support.view_client import ViewClient, view_client
from tests.support.waiting import DEADLINE_S, until
from tests.support.world import ROBOTCTL, World, new_world

LAYOUT = Path(__file__).parents[2] / "docs" / "foxglove-layout.json"


@pytest.fixture(scope="module")
def driving() -> Iterator[World]:
    """A world with a robot that drives."""
    with new_world() as world:
        world.ok("start", "--sim", "--drive", "circle")
        yield world
        world.ok("stop")


@contextmanager
def view_of(world: World, *options: str) -> Iterator[tuple[subprocess.Popen[str], dict[str, Any]]]:
    """Run the command during a block; yield the process and what it prints first."""
    process = world.spawn("view", "--port", "0", "--json", *options)
    assert process.stdout is not None
    first = process.stdout.readline()
    assert first, process.communicate()
    try:
        yield process, json.loads(first)
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            assert process.wait(30) == 130


async def test_every_topic_of_a_robot_is_offered_with_its_type_and_messages(
    driving: World,
) -> None:
    with view_of(driving) as (_, ready):
        async with view_client(ready["url"]) as client:
            topics = ("/odom", "/cmd_vel", "/robotctl/journal", "/robot_status", "/robotctl/marks")
            await client.subscribe(*topics)
            driving.ok("mark", "seen by the view")
            await client.until(lambda: all(client.of(topic) for topic in topics))
            odometry = decoded(client, "/odom")
            assert odometry["header"]["frame_id"] == "odom"
            await client.until(lambda: decoded(client, "/cmd_vel")["linear"]["x"] > 0.0)
            assert "seen by the view" in str(decoded(client, "/robotctl/marks"))
            layout = json.loads(LAYOUT.read_text())
            await client.until(lambda: layout_topics(layout) <= client.channels.keys())
            check_layout(layout, client)


def decoded(client: ViewClient, topic: str) -> dict[str, Any]:
    """Return the last message of a topic, decoded by the schema of its offer."""
    channel = client.channels[topic]
    definition = parse_definition(channel["schemaName"], channel["schema"])
    return decode(definition, client.of(topic)[-1].data)


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


async def test_a_second_viewer_gets_what_is_latched(driving: World) -> None:
    with view_of(driving) as (_, ready):
        async with view_client(ready["url"]) as one, view_client(ready["url"]) as two:
            for client in (one, two):
                await client.subscribe("/rosout")
                await client.until(lambda: client.of("/rosout"))  # noqa: B023 - awaited here


async def test_the_command_cannot_be_published_and_a_new_run_has_a_new_token(
    driving: World,
) -> None:
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


async def test_it_ends_with_the_daemon_and_says_so(world: World) -> None:
    world.ok("start", "--sim")
    process = world.spawn("view")
    assert process.stdout is not None
    lines = [process.stdout.readline() for _ in range(3)]
    url = lines[1].split()[-1]
    assert max(map(len, lines[:2])) <= 81
    async with view_client(url) as client:
        await client.until(lambda: client.op("serverInfo"))
        world.ok("stop")
        with pytest.raises(ConnectionClosed):
            await client.until(lambda: False)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 3
    assert err == "robotctl: the daemon of robot 'robot' has ended\n"


async def test_a_killed_command_leaves_no_process(driving: World) -> None:
    with view_of(driving) as (process, _):
        (child,) = (pid for pid, line in driving.processes().items() if "robotctl.view" in line)
        os.kill(process.pid, signal.SIGKILL)
        process.wait(30)
        until(lambda: child not in driving.processes())


def test_without_a_daemon_it_says_how_to_start_one(world: World) -> None:
    ran = world.here("view")
    assert ran.exit_code == 3
    assert "robotctl start" in ran.err


async def test_with_control_any_viewer_stops_the_robot_and_none_moves_it(world: World) -> None:
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
    world.ok("stop")


async def test_with_the_lease_a_viewer_drives_until_it_is_silent(world: World) -> None:
    world.ok("start", "--sim")
    process = world.spawn(
        *("lease", "take", "--", ROBOTCTL, "view", "--port", "0", "--json", "--control")
    )
    assert process.stdout is not None
    ready = json.loads(process.stdout.readline())
    async with view_client(ready["url"]) as client:
        await client.until(lambda: client.op("serverInfo"))
        assert client.op("serverInfo")[0]["capabilities"] == ["services", "clientPublish"]
        await client.offer_twist(encoding="cdr")
        await client.until(lambda: client.op("status"))
        await client.offer_twist()
        await client.publish_twist(0.3, float("nan"))
        await client.until(lambda: len(client.op("status")) == 2)
        assert world.status()["mode"] == "IDLE"
        await driven_until(client, lambda: world.status()["mode"] == "MOVING")
        await asyncio.to_thread(until, lambda: world.status()["mode"] == "IDLE")
        await driven_until(client, lambda: world.status()["mode"] == "MOVING")
        world.here("estop")
        await driven_until(client, lambda: client.op("status")[-1].get("id") == "drive")
        assert "let go" in client.op("status")[-1]["message"]
        world.here("reset")
        await driven_for(client, 1.0)
        assert world.status()["mode"] == "IDLE"  # the operator has not let go
    (view,) = (
        pid
        for pid, line in world.processes().items()
        if " view --port" in line and "lease" not in line
    )
    os.kill(view, signal.SIGINT)  # as Ctrl-C does to all processes of the terminal
    process.wait(60)
    world.ok("stop")


async def driven_until(client: ViewClient, condition: Callable[[], object]) -> None:
    """Publish a velocity at 40 Hz until a condition holds."""
    async with asyncio.timeout(DEADLINE_S):
        while not await asyncio.to_thread(condition):
            await driven_for(client, 0.1)


async def driven_for(client: ViewClient, seconds: float) -> None:
    """Publish a velocity at 40 Hz for a time."""
    for _ in range(round(seconds * 40)):
        await client.publish_twist(0.2, 0.0)
        await client.receive_for(0.025)
