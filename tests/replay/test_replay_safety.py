"""A replay is never mistaken for a robot, and no robot obeys it."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from tests.support.bags import (
    OTHER_HASH,
    STRING,
    TWIST,
    Line,
    data,
    in_order,
    talk,
    twist,
    write_bag,
)

Until = Callable[[Callable[[], object]], Awaitable[None]]


async def test_with_a_daemon_in_the_domain_everything_goes_below_replay(
    tmp_path: Path, listener: Any, replay: Any, daemon: Any, until: Until
) -> None:
    commands = [Line("/cmd_vel", TWIST, n, twist(1.0)) for n in range(10)]
    file = write_bag(tmp_path / "run.mcap", in_order(commands, talk("/odd/alpha", 10)))
    for topic, type_name in (("/cmd_vel", TWIST), ("/odd/alpha", STRING)):
        listener.listen(topic, type_name)
        listener.listen(f"/replay{topic}", type_name)
    async with daemon("r2", mode="MOVING"):
        ran = await replay(file)
    assert ran.exit_code == 0, ran.err
    assert ran.out.count("\n") == 3
    assert ran.out.startswith("a daemon ('r2') runs in ROS domain ")
    assert "below /replay" in ran.out.splitlines()[0]
    await until(lambda: len(listener.heard["/replay/odd/alpha"]) == 10)
    assert listener.heard["/replay/cmd_vel"] == data(commands)
    assert listener.heard["/cmd_vel"] == listener.heard["/odd/alpha"] == []


async def test_a_daemon_in_another_domain_changes_no_name(
    tmp_path: Path, replay: Any, daemon: Any, domain_id: int
) -> None:
    file = write_bag(tmp_path / "run.mcap", talk("/alpha", 10))
    async with daemon(domain=domain_id + 1):
        ran = await replay(file, "--json")
    assert (ran.summary["prefix"], ran.summary["notes"]) == ("", [])


async def test_without_a_domain_of_ones_own_the_replay_goes_where_the_robots_daemon_is(
    tmp_path: Path, replay: Any, daemon: Any, domain_id: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = write_bag(tmp_path / "run.mcap", talk("/alpha", 3))
    monkeypatch.delenv("ROS_DOMAIN_ID")
    async with daemon("r2"):
        ran = await replay(file, "--robot", "r2", "--json")
    assert (ran.summary["domain_id"], ran.summary["prefix"]) == (domain_id, "/replay")


async def test_the_cure_for_changed_types_moves_no_idle_robot(
    tmp_path: Path, listener: Any, replay: Any, daemon: Any, until: Until
) -> None:
    commands = [Line("/cmd_vel", TWIST, n, twist(1.0)) for n in range(10)]
    changed = talk("/alpha", 10, type_hash=OTHER_HASH)
    file = write_bag(tmp_path / "run.mcap", in_order(commands, changed))
    for topic, type_name in (("/cmd_vel", TWIST), ("/replay/cmd_vel", TWIST)):
        listener.listen(topic, type_name)
    async with daemon():
        ran = await replay(file)
        assert ran.exit_code == 4
        assert "play it anyway: --force-types)" in ran.err
        ran = await replay(file, "--force-types")
    assert ran.exit_code == 0, ran.err
    await until(lambda: listener.heard["/replay/cmd_vel"] == data(commands))
    assert listener.heard["/cmd_vel"] == []


async def test_original_names_beside_a_daemon_take_commands_along_where_they_are_named(
    tmp_path: Path, listener: Any, replay: Any, daemon: Any, until: Until
) -> None:
    commands = [Line("/cmd_vel", TWIST, n, twist(1.0)) for n in range(10)]
    file = write_bag(tmp_path / "run.mcap", in_order(commands, talk("/alpha", 10)))
    listener.listen("/cmd_vel", TWIST)
    listener.listen("/alpha", STRING)
    async with daemon():
        ran = await replay(file, "--original-names", "--json")
        assert ran.summary["withheld"] == {"/cmd_vel": 10}
        await until(lambda: len(listener.heard["/alpha"]) == 10)
        assert listener.heard["/cmd_vel"] == []
        named = ("--topics", "/cmd_vel", "--regex", ".")
        ran = await replay(file, "--original-names", *named, "--json")
    assert ran.exit_code == 0, ran.err
    assert (ran.summary["prefix"], ran.summary["withheld"]) == ("", {})
    await until(lambda: listener.heard["/cmd_vel"] == data(commands))
    await until(lambda: len(listener.heard["/alpha"]) == 20)


async def test_original_names_are_refused_while_the_robot_moves(
    tmp_path: Path, listener: Any, replay: Any, daemon: Any
) -> None:
    file = write_bag(tmp_path / "run.mcap", talk("/alpha", 10))
    listener.listen("/alpha", STRING)
    async with daemon("r2", mode="MOVING"), daemon("r1"):
        ran = await replay(file, "--original-names")
    assert (ran.exit_code, ran.out) == (4, "")
    assert ran.err.startswith("robotctl: --original-names is refused while robot 'r2' is MOVING")
    assert listener.heard["/alpha"] == []


async def test_original_names_end_when_the_robot_begins_to_move(
    tmp_path: Path, listener: Any, start: Any, daemon: Any, until: Until
) -> None:
    file = write_bag(tmp_path / "run.mcap", talk("/alpha", 1000, 100.0))
    listener.listen("/alpha", STRING)
    async with daemon() as running:
        replaying = start(file, "--original-names")
        await until(lambda: listener.heard["/alpha"])
        running.mode = "MOVING"
        ran = await replaying.end()
    assert ran.exit_code == 4
    assert "is MOVING" in ran.err


async def test_a_daemon_that_comes_during_a_replay_ends_it(
    tmp_path: Path, listener: Any, start: Any, daemon: Any, until: Until
) -> None:
    file = write_bag(tmp_path / "run.mcap", talk("/alpha", 1000, 100.0))
    listener.listen("/alpha", STRING)
    replaying = start(file)
    await until(lambda: listener.heard["/alpha"])
    async with daemon():
        ran = await replaying.end()
    assert ran.exit_code == 4
    assert "has joined ROS domain" in ran.err
    await until(lambda: listener.node.count_publishers("/alpha") == 0)


@pytest.mark.slow
async def test_a_daemon_of_somebody_else_is_seen_on_the_ros_graph(
    tmp_path: Path, listener: Any, replay: Any
) -> None:
    from robot_controller.msg import JournalEntry

    file = write_bag(tmp_path / "run.mcap", talk("/alpha", 10))
    listener.node.create_publisher(JournalEntry, "/r3/robotctl/journal", 10)
    ran = await replay(file, "--json")
    assert ran.summary["prefix"] == "/replay"
    ran = await replay(file, "--original-names")
    assert ran.exit_code == 4
    assert "in an unknown mode" in ran.err


@pytest.mark.parametrize("topic", ["/cmd_vel", pytest.param("/base/speed", marks=pytest.mark.slow)])
async def test_commands_are_withheld_unless_named(
    topic: str, tmp_path: Path, listener: Any, replay: Any, until: Until
) -> None:
    commands = [Line(topic, TWIST, n, twist(1.0)) for n in range(10)]
    file = write_bag(tmp_path / "run.mcap", in_order(commands, talk("/alpha", 10)))
    listener.listen(topic, TWIST)
    listener.listen("/alpha", STRING)
    ran = await replay(file, "--json")
    assert ran.summary["withheld"] == {topic: 10}
    assert f"--topics {topic}" in ran.summary["notes"][0]
    await until(lambda: len(listener.heard["/alpha"]) == 10)
    assert listener.heard[topic] == []
    ran = await replay(file, "--topics", topic)
    assert ran.exit_code == 0
    await until(lambda: listener.heard[topic] == data(commands))


async def test_commands_are_not_even_announced_to_a_robot_that_comes_later(
    tmp_path: Path, listener: Any, start: Any, until: Until
) -> None:
    commands = [Line("/cmd_vel", TWIST, n * 10.0, twist(1.0)) for n in range(10_000)]
    file = write_bag(tmp_path / "run.mcap", in_order(commands, talk("/alpha", 1000, 100.0)))
    listener.listen("/alpha", STRING)
    replaying = start(file, "--json")
    await until(lambda: listener.heard["/alpha"])
    listener.listen("/cmd_vel", TWIST)
    heard = len(listener.heard["/alpha"])
    await until(lambda: len(listener.heard["/alpha"]) > heard + 10)
    assert listener.node.count_publishers("/cmd_vel") == 0
    assert listener.heard["/cmd_vel"] == []
    replaying.interrupt()
    ran = await replaying.end()
    assert ran.summary["withheld"] == {"/cmd_vel": 10_000}
