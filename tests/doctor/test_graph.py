"""What keeps command and odometry from arriving is read from the graph."""

from __future__ import annotations

import pytest

from robotctl.doctor import MAX_NAMED, Level, check_command, check_definitions, check_odometry
from robotctl.ipc.answers import GraphEndpoint, GraphTopic, NameAndTypes

TWIST, STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
ODOMETRY = "nav_msgs/msg/Odometry"


def endpoint(
    node: str, kind: str, reliability: str = "reliable", durability: str = "volatile"
) -> GraphEndpoint:
    qos: dict[str, str | int] = {"reliability": reliability, "durability": durability, "depth": 1}
    return {"node": node, "type": kind, "gid": "1", "qos": qos}


def topic(
    name: str, publishers: list[GraphEndpoint], subscriptions: list[GraphEndpoint]
) -> GraphTopic:
    types = sorted({each["type"] for each in (*publishers, *subscriptions)})
    return {
        "name": name,
        "types": types,
        "publishers": publishers,
        "subscriptions": subscriptions,
    }


def command_faults(found: GraphTopic, *, has_odometry: bool = True) -> list[str]:
    findings = check_command(found, has_odometry=has_odometry)
    return [each.text for each in findings if each.level is not Level.OK]


def test_a_healthy_graph_and_an_empty_one_give_no_alarm() -> None:
    command = topic("/cmd_vel", [endpoint("/daemon", TWIST)], [endpoint("/base", TWIST)])
    odometry = topic(
        "/odom", [endpoint("/base", ODOMETRY)], [endpoint("/daemon", ODOMETRY, "best_effort")]
    )
    assert command_faults(command) == []
    assert command_faults(topic("/cmd_vel", [], []), has_odometry=False) == []
    assert [each.level for each in check_odometry(odometry)] == [Level.OK]
    assert [each.level for each in check_odometry(topic("/odom", [], []))] == [Level.OK]


@pytest.mark.parametrize(
    ("publishers", "subscriptions", "text"),
    [
        ([endpoint("/daemon", TWIST)], [], "no node subscribes to /cmd_vel"),
        ([], [endpoint("/_recorder", TWIST)], "no node subscribes to /cmd_vel"),
        (
            [endpoint("/daemon", TWIST)],
            [endpoint("/base", STAMPED)],
            f"several types, {TWIST} by /daemon; {STAMPED} by /base",
        ),
        ([], [endpoint("/base", "std_msgs/msg/String")], "has type std_msgs/msg/String, not"),
        (
            [endpoint("/nav", TWIST), endpoint("/joy", TWIST)],
            [endpoint("/base", TWIST)],
            "/joy and /nav publish /cmd_vel",
        ),
        (
            [endpoint("/nav", TWIST, "best_effort")],
            [endpoint("/base", TWIST)],
            "/base hears nothing of /nav on /cmd_vel: reliability best_effort is offered",
        ),
        (
            [endpoint("/nav", TWIST)],
            [endpoint("/base", TWIST, durability="transient_local")],
            "durability volatile is offered, transient_local asked for",
        ),
    ],
)
def test_what_keeps_a_command_from_arriving_is_named(
    publishers: list[GraphEndpoint], subscriptions: list[GraphEndpoint], text: str
) -> None:
    (found,) = command_faults(topic("/cmd_vel", publishers, subscriptions))
    assert text in found


def test_a_flood_of_endpoints_gives_a_few_findings_at_once() -> None:
    weak = [endpoint(f"/p{number}", TWIST, "best_effort") for number in range(5_000)]
    strong = [endpoint(f"/s{number}", TWIST) for number in range(5_000)]
    found = command_faults(topic("/cmd_vel", weak, strong))
    assert len(found) == MAX_NAMED + 1
    assert max(map(len, found)) < 300


def test_two_sources_of_odometry_are_a_fault() -> None:
    twice = [endpoint("/base", ODOMETRY), endpoint("/bag", ODOMETRY)]
    found = [each for each in check_odometry(topic("/odom", twice, [])) if each.cure]
    assert [each.text for each in found] == [
        "/bag and /base publish /odom: robotctl uses the first"
    ]


def test_types_without_a_definition_are_named_up_to_a_number() -> None:
    types = [*map("far/msg/T{}".format, range(8)), ODOMETRY]
    topics = [NameAndTypes(name=f"/t{at}", types=[kind]) for at, kind in enumerate(types)]
    (found,) = check_definitions(topics)
    assert "far/msg/T0 (of /t0)" in found.text
    assert "and 3 more" in found.text
    (fine,) = check_definitions(topics[-1:])
    assert fine.level is Level.OK
