"""What is played and under which names; commands that a robot would obey are withheld."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from robotctl.errors import UsageError
from robotctl.recording import TopicInfo
from robotctl.replay import plan
from robotctl.replay.job import Job, check_clock, check_regex, parse_remap
from robotctl.replay.plan import Route
from robotctl.replay.replay_guard import ReplayGuard, is_command

STRING, TWIST = "std_msgs/msg/String", "geometry_msgs/msg/Twist"
EVENT = "std_srvs/srv/SetBool_Event"


def topic(name: str, type_name: str = STRING) -> TopicInfo:
    return TopicInfo(name, type_name, 1, 1.0, "cdr", "", "", "ros2msg", "")


TOPICS = (
    topic("/odom"),
    topic("scan"),
    topic("/cmd_vel", TWIST),
    topic("/light/_service_event", EVENT),
)


def job(**options: Any) -> Job:
    return Job(Path("run.mcap"), 0, **options)


def names(**options: Any) -> set[str]:
    return {each.name for each in plan.selected(TOPICS, job(**options))}


def routed(*recorded: TopicInfo, **options: Any) -> dict[str, str]:
    return {r.topic.name: r.name for r in plan.routes(recorded, recorded, job(**options))}


def test_a_regular_expression_selects_beside_the_names() -> None:
    assert names() == {each.name for each in TOPICS}
    assert names(regex="^/(odom|scan)$") == {"/odom", "scan"}
    assert names(regex="od") == {"/odom"}
    assert names(regex="od", topics=("scan",)) == {"/odom", "scan"}
    assert names(regex=".", exclude=("/scan",)) == {each.name for each in TOPICS} - {"scan"}
    assert names(regex="nothing") == set()


def test_a_service_is_named_as_itself_or_as_its_introspection() -> None:
    for name in ("/light", "light", "/light/_service_event"):
        assert names(topics=(name,)) == {"/light/_service_event"}
        assert "/light/_service_event" not in names(exclude=(name,))


@pytest.mark.parametrize("type_name", [STRING, "a/srv/T", "a/msg/T_Event", "/srv/_Event"])
def test_a_topic_is_no_service_by_its_name_alone(type_name: str) -> None:
    assert plan.service_of(topic("/light/_service_event", type_name)) == ""


def test_requests_go_to_the_service_only_where_they_are_asked_for() -> None:
    event = TOPICS[3]
    assert plan.routes([event], [event], job()) == [Route(event, "/light/_service_event")]
    assert plan.routes([event], [event], job(service_requests=True)) == [
        Route(event, "/light", requests=True)
    ]
    remaps = (("/light", "/lamp"),)
    assert routed(event, service_requests=True, remaps=remaps) == {event.name: "/lamp"}


def test_names_become_absolute_and_can_be_changed() -> None:
    remaps = (("scan", "front/scan"), ("/odom", "/old/odom"))
    assert routed(*TOPICS[:3], remaps=remaps) == {
        "/odom": "/old/odom",
        "scan": "/front/scan",
        "/cmd_vel": "/cmd_vel",
    }


def test_two_topics_of_one_type_may_become_one() -> None:
    assert set(routed(*TOPICS[:2], remaps=(("scan", "odom"),)).values()) == {"/odom"}


def test_two_types_under_one_name_are_refused() -> None:
    with pytest.raises(UsageError, match="/odom would be published both as"):
        routed(*TOPICS, remaps=(("/cmd_vel", "/odom"),))


def test_a_remap_of_what_is_not_recorded_is_refused() -> None:
    with pytest.raises(UsageError, match="--remap /nope: not in the recording, which has"):
        routed(*TOPICS, remaps=(("/nope", "/odom"),))


@pytest.mark.parametrize(
    "text",
    ["", "/a", "/a:=", ":=/b", "/a=/b", "/a:=/1b", "/a:=/b/", "/a:=//b", "/a:=/b c", "/a:=/ä",
     "/a:=~/b", "/a:={ns}/b", "/a:=/b:=/c"],
)  # fmt: skip
def test_a_remap_to_what_is_no_name_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="use OLD:=NEW"):
        parse_remap(text)


def test_what_is_no_regular_expression_and_no_frequency_is_refused() -> None:
    with pytest.raises(UsageError, match=r"--regex \(: "):
        check_regex("(")
    for hertz in (0.0, -1.0, float("nan"), 1e9):
        with pytest.raises(UsageError, match="--clock"):
            check_clock(hertz)


def test_a_job_crosses_to_the_player_unchanged() -> None:
    asked = job(
        rate=None,
        topics=("/a", "/b"),
        exclude=("/c",),
        regex="d|e",
        remaps=(("/f", "/g"), ("/h", "/i")),
        clock_hz=10.0,
        wait_for=2,
        read_ahead=7,
        paused=True,
    )
    assert Job.from_json(asked.to_json()) == asked


@dataclass
class FakeGraph:
    """The participants of the domain."""

    daemons: list[str] = field(default_factory=list)

    def robots_with_daemon(self) -> list[str]:
        return self.daemons


def withheld(*routes: Route, named: tuple[str, ...] = (), daemon: str = "") -> set[str]:
    safety = ReplayGuard(FakeGraph([daemon] if daemon else []), 250, named, original_names=False)
    safety.choose_prefix()
    return {route.name for route in safety.withheld(safety.prefixed(routes))}


def test_a_remap_onto_the_command_topic_is_a_command() -> None:
    route = Route(topic("/speech"), "/robot/cmd_vel")
    assert is_command(route)
    assert withheld(route) == {"/robot/cmd_vel"}
    assert withheld(route, named=("speech",)) == set()


def test_a_command_under_another_name_is_still_one() -> None:
    route = Route(topic("/cmd_vel", TWIST), "/elsewhere")
    assert withheld(route) == {"/elsewhere"}
    assert withheld(route, named=("/cmd_vel",)) == set()


def test_requests_are_withheld_unless_their_service_is_named() -> None:
    route = Route(TOPICS[3], "/light", requests=True)
    assert withheld(route) == {"/light"}
    assert withheld(route, named=("/light",)) == set()


def test_below_the_prefix_nothing_needs_to_be_withheld() -> None:
    route = Route(topic("/cmd_vel", TWIST), "/cmd_vel")
    assert withheld(route, daemon="r3") == set()


def test_a_regular_expression_names_no_command() -> None:
    chosen = plan.selected(TOPICS, job(regex="."))
    routes = plan.routes(TOPICS, chosen, job(regex="."))
    assert withheld(*routes) == {"/cmd_vel"}
