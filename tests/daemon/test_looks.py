"""`topic`, `node` and `service` on ROS, through the daemon and through a process of their own."""

from __future__ import annotations

import json
import re
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.support.lines import Told, line_of, peer_command
from tests.support.waiting import until
from tests.support.world import World, world_with_daemon


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    """A world with a daemon, and two peers that announce topics of strange types."""
    hostile = peer_command("tests.support.hostile_peer")
    with (
        world_with_daemon() as made,
        Told(hostile, made.environment) as one,
        Told(hostile, made.environment) as other,
    ):
        one("offer", topic="/strange", type_name="nowhere/msg/Type")
        one("offer", topic="/bad\xff\x1b[31m", type_name="std_msgs/msg/String")
        one("offer", topic="/two", type_name="std_msgs/msg/String")
        other("offer", topic="/two", type_name="std_msgs/msg/Header")

        def are_known() -> bool:
            topics = made.answer_here("topic", "list")["topics"]
            types = {each["name"]: each["types"] for each in topics}
            return len(types.get("/two", ())) == 2 and "/strange" in types

        until(are_known)
        yield made


def test_processes_of_their_own_tell_what_the_daemon_tells(world: World) -> None:
    looks = (
        *(("topic", "list", "--all"), ("node", "list", "--all"), ("service", "list", "--all")),
        ("node", "info", "/mode_service"),
    )
    domain = ("--domain-id", str(world.domain_id), "--json")
    seen: list[tuple[Any, Any]] = []

    def agree() -> bool:  # a process of its own waits 3.5 s for discovery, and no longer
        started = [world.spawn(*look, *domain) for look in looks]
        own = [json.loads(each.communicate()[0]) for each in started]
        seen.append((own, [world.answer_here(*look) for look in looks]))
        return bool(own == seen[-1][1])

    try:
        until(agree)
    except AssertionError:
        raise AssertionError(seen[-1]) from None


def test_the_lists_hold_the_daemons_names_and_no_escape_sequence(world: World) -> None:
    topics = world.here("topic", "list", "-t").out
    assert "/cmd_vel [geometry_msgs/msg/Twist]" in topics.splitlines()
    assert "\x1b" not in topics
    assert "/velocity_publisher" in world.here("node", "list").out.splitlines()
    services = world.here("service", "list", "-t").out.splitlines()
    assert "/set_mode [robot_controller/srv/SetMode]" in services


def test_a_topic_and_a_node_are_told_with_all_they_have(world: World) -> None:
    topic = world.answer_here("topic", "info", "odom")
    assert topic["types"] == ["nav_msgs/msg/Odometry"]
    assert [each["node"] for each in topic["publishers"]] == ["/simulated_robot"]
    servers = world.answer_here("node", "info", "/mode_service")["servers"]
    assert {"name": "/set_mode", "types": ["robot_controller/srv/SetMode"]} in servers


ONCE = ("--once", "--timeout", "60")


def said(world: World, *arguments: str) -> str:
    ran = world.here(*arguments)
    assert ran.exit_code == 0, ran
    return ran.out


def test_a_live_message_is_yaml_and_a_field_a_line(world: World) -> None:
    (message, _) = yaml.safe_load_all(said(world, "topic", "echo", "/odom", *ONCE))
    assert message["child_frame_id"] == "base_link"
    assert said(world, "topic", "echo", "odom", "child_frame_id", *ONCE) == "base_link\n"
    value = world.answer_here("topic", "echo", "odom", "pose.pose.orientation.w", *ONCE)
    assert value["value"] == 1.0


def test_a_latched_message_reaches_who_comes_late(world: World) -> None:
    assert world.answer_here("topic", "echo", "/robot_status", *ONCE)["message"]["mode"] == 0


def test_a_service_is_called_with_its_type_or_without(world: World) -> None:
    answer = world.answer_here("service", "call", "/set_mode", "{requested_mode: 0}")["response"]
    assert (answer["success"], answer["current_mode"]) == (True, 0)
    answered = said(
        world, "service", "call", "/set_mode", "robot_controller/srv/SetMode", "{requested_mode: 9}"
    )
    assert yaml.safe_load(answered)["success"] is False


@pytest.mark.parametrize(
    ("arguments", "exit_code", "said"),
    [
        (["topic", "echo", "/odomm"], 2, "no topic /odomm: did you mean /odom?"),
        (["topic", "echo", "/odom", "pose.pose.positon"], 2, "did you mean position?"),
        (["topic", "echo", "/strange"], 4, "nowhere/msg/Type, which is not installed"),
        (["topic", "echo", "/two"], 2, "has several types: std_msgs/msg/Header, std_msgs/msg/Str"),
        (
            ["topic", "echo", "/two", "--type", "std_msgs/msg/String", "--timeout", "0.1"],
            4,
            "for 0",
        ),
        (["node", "info", "/mode_servic"], 2, "did you mean /mode_service?"),
        (["service", "call", "/set_mode", "{mode: 1}"], 2, "did you mean requested_mode?"),
        (["service", "call", "/set_mode", "std_srvs/srv/Trigger"], 2, "leave the type out"),
        (["service", "call", "/set_mod"], 3, "did you mean /set_mode?"),
        pytest.param(
            ["service", "call", "/ghost", "std_srvs/srv/Trigger"],
            3,
            "no process serves /ghost as std_srvs/srv/Trigger within 5 s",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_what_cannot_be_done_is_a_sentence_and_an_exit_code(
    world: World, arguments: list[str], exit_code: int, said: str
) -> None:
    err = world.here(*arguments).refused(exit_code, said)
    assert "\x1b" not in err


def test_ctrl_c_ends_a_look_without_a_traceback(world: World) -> None:
    process = world.spawn("topic", "echo", "/odom", "child_frame_id")
    assert line_of(process.stdout) == "base_link\n"
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in err


PAGE = Path(__file__).parents[2] / "docs" / "ros.md"
ROW = re.compile(
    r"^\| out \| `([\w/]+)` \| `([\w/]+)`[^|]* \| ([a-z ]+), ([a-z ]+), \d+ \|", re.MULTILINE
)


@pytest.mark.parametrize(
    ("topic", "kind", "reliability", "durability"), ROW.findall(PAGE.read_text())
)
def test_the_page_tells_type_and_qos_of_each_topic_of_the_daemon(
    world: World, topic: str, kind: str, reliability: str, durability: str
) -> None:
    told = world.answer_here("topic", "info", topic)
    assert told["types"] == [kind]
    (qos,) = (each["qos"] for each in told["publishers"])
    assert qos["reliability"] == reliability.replace(" ", "_")
    assert qos["durability"] == durability.replace(" ", "_")
