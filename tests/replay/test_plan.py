"""What is played and under which names; commands that a robot would obey are withheld.

Each option of a replay, as other nodes in the domain see it.
A replay offers the recorded quality of service, as far as it can be understood.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from rclpy.qos import (
    DurabilityPolicy,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)
from rclpy.serialization import serialize_message
from service_msgs.msg import ServiceEventInfo
from std_srvs.srv import SetBool

from robotctl.base.errors import UsageError
from robotctl.cli import app
from robotctl.recording import TopicInfo
from robotctl.replay import plan
from robotctl.replay.job import Job, parse_remap
from robotctl.replay.plan import Route
from robotctl.replay.replay_guard import ReplayGuard, is_command
from robotctl.ros.playback import MAX_DEPTH, VOLATILE_DEPTH, latched_depth, replay_qos
from robotctl.ros.qos import LATCHED, SENSOR, to_yaml
from tests.replay.conftest import Stage
from tests.support.bags import OTHER_HASH, START_NS, STRING, TWIST, Line, data, talk, write_bag
from tests.support.waiting import loop_until as until

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


def test_requests_go_to_the_service_only_where_they_are_asked_for() -> None:
    event = TOPICS[3]
    assert plan.routes([event], [event], job()) == [Route(event, "/light/_service_event")]
    assert plan.routes([event], [event], job(service_requests=True)) == [
        Route(event, "/light", requests=True)
    ]
    remaps = (("/light", "/lamp"),)
    assert routed(event, service_requests=True, remaps=remaps) == {event.name: "/lamp"}


def test_two_types_under_one_name_are_refused() -> None:
    with pytest.raises(UsageError, match="/odom would be published both as"):
        routed(*TOPICS, remaps=(("/cmd_vel", "/odom"),))


@pytest.mark.parametrize(
    "text",
    ["", "/a", "/a:=", ":=/b", "/a=/b", "/a:=/1b", "/a:=/b/", "/a:=//b", "/a:=/b c", "/a:=/ä",
     "/a:=~/b", "/a:={ns}/b", "/a:=/b:=/c"],
)  # fmt: skip
def test_a_remap_to_what_is_no_name_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="use OLD:=NEW"):
        parse_remap(text)


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


def test_a_regular_expression_names_no_command() -> None:
    chosen = plan.selected(TOPICS, job(regex="."))
    routes = plan.routes(TOPICS, chosen, job(regex="."))
    assert withheld(*routes) == {"/cmd_vel"}


CLOCK = "rosgraph_msgs/msg/Clock"


def event(at_ms: float, kind: int, number: int, *, value: bool | None, client: int = 1) -> Line:
    """Return the introspection of a call of /light; `value` None is an answer."""
    info = ServiceEventInfo(event_type=kind, sequence_number=number)
    info.client_gid[:] = client
    requests = [] if value is None else [SetBool.Request(data=value)]
    content = serialize_message(SetBool.Event(info=info, request=requests))
    return Line("/light/_service_event", EVENT, at_ms, bytes(content))


async def test_topics_are_chosen_by_a_regular_expression_and_published_under_other_names(
    stage: Stage,
) -> None:
    lines = talk("/alpha", 10) + talk("/beta", 10) + talk("/gamma", 10)
    file = stage.bag(lines)
    stage.listen("/alpha", "/beta", "/gamma", "/other/beta")
    ran = await stage.replay(
        file, "--regex", "^/b", "--topics", "gamma", "--remap", "beta:=other/beta",
        "--read-ahead", "1", "--delay", "0.1", "--json",
    )  # fmt: skip
    assert ran.exit_code == 0, ran.err
    await until(lambda: len(stage.heard["/other/beta"]) == len(stage.heard["/gamma"]) == 10)
    assert stage.heard["/other/beta"] == data(lines[10:20])
    assert stage.heard["/alpha"] == stage.heard["/beta"] == []
    published = {topic["name"]: topic["published"] for topic in ran.summary["topics"]}
    assert published == {"/beta": "/other/beta", "/gamma": "/gamma"}


async def test_a_type_that_has_changed_is_refused_unless_left_out_or_insisted_on(
    stage: Stage,
) -> None:
    alpha, beta = talk("/alpha", 5), talk("/beta", 5, type_hash=OTHER_HASH)
    file = stage.bag(alpha + beta, heard=True)
    ran = await stage.replay(file, "--exclude", "/beta", "--json")
    assert (ran.exit_code, ran.summary["sent"]) == (0, 5)
    await until(lambda: stage.heard == {"/alpha": data(alpha), "/beta": []})
    ran = await stage.replay(file, "--json")
    assert ran.exit_code == 4
    error = ran.summary["error"]
    assert "another definition than the installed one: /beta (std_msgs/msg/String)" in str(error)
    assert "/alpha" not in str(error)
    assert error["cure"] == "leave it out: --exclude NAME; play it anyway: --force-types"
    assert error["cause"].endswith("subscribers would misread it")
    ran = await stage.replay(file, "--force-types", "--topics", "/beta", "--json")
    assert "--force-types plays it anyway" in ran.summary["notes"][0]
    await until(lambda: stage.heard["/beta"] == data(beta))


async def test_nothing_is_sent_before_the_subscribers_that_are_waited_for_are_there(
    stage: Stage,
) -> None:
    alpha, beta = talk("/alpha", 20, 1.0), talk("/beta", 20, 1.0)
    file = stage.bag(alpha + beta)
    running = stage.start(file, "--wait-for", "2", "--json")
    stage.listen("/alpha")
    await until(lambda: stage.node.count_publishers("/beta"))
    stage.listen("/beta")
    ran = await running.end()
    assert (ran.exit_code, ran.summary["sent"]) == (0, 40)
    await until(lambda: stage.heard == {"/alpha": data(alpha), "/beta": data(beta)})


async def test_recorded_time_is_published_in_place_of_the_recorded_clock(stage: Stage) -> None:
    recorded = Line("/clock", CLOCK, 10.0, struct.pack("<4siI", b"\0\1", 1, 2))
    lines = [*talk("/alpha", 11, 50.0), recorded]
    file = stage.bag(lines)
    stage.listen("/clock", type_name=CLOCK)
    ran = await stage.replay(file, "--clock", "50", "--json")
    assert ran.exit_code == 0, ran.err
    assert set(ran.summary["skipped"]) == {"/clock"}
    heard = stage.heard["/clock"]
    await until(lambda: len(heard) >= 3)
    times = [sec * 1_000_000_000 + ns for _, sec, ns in (struct.unpack("<4siI", d) for d in heard)]
    assert times == sorted(times)
    assert times[0] >= START_NS
    late_ns = round(ran.summary["timing_error_us"]["max"] * 1e3)
    assert times[-1] <= START_NS + 500_000_000 + late_ns  # it goes on until the last one is sent


async def test_a_second_clock_is_refused(stage: Stage) -> None:
    from rosgraph_msgs.msg import Clock

    file = stage.bag(talk("/alpha", 5))
    stage.node.create_publisher(Clock, "/clock", 10)
    ran = await stage.replay(file, "--clock", "10")
    assert (ran.exit_code, ran.out) == (4, "")
    assert ran.err.startswith("robotctl: --clock is refused: /listener publishes /clock already")


async def test_recorded_requests_are_sent_once_each_to_the_service_that_is_named(
    stage: Stage,
) -> None:
    sent, received, answered = (
        ServiceEventInfo.REQUEST_SENT,
        ServiceEventInfo.REQUEST_RECEIVED,
        ServiceEventInfo.RESPONSE_SENT,
    )
    lines = [
        event(0, sent, 1, value=True),
        event(1, received, 1, value=True, client=2),  # the same, as the server reports it
        event(2, answered, 1, value=None),
        event(3, received, 2, value=False),
        event(4, sent, 2, value=False, client=2),
        event(5, received, 3, value=True),  # of a client without an id
        event(6, received, 3, value=True, client=3),  # and of another
    ]
    file = stage.bag(lines)
    asked: list[bool] = []

    def switch(request: Any, response: Any) -> Any:
        asked.append(request.data)
        return response

    stage.node.create_service(SetBool, "/light", switch)
    ran = await stage.replay(file, "--publish-service-requests", "--json")
    assert ran.summary["withheld"] == {"/light/_service_event": len(lines)}
    assert "a robot would obey these requests" in ran.summary["notes"][0]
    ran = await stage.replay(file, "--publish-service-requests", "--topics", "/light", "--json")
    assert (ran.summary["sent"], ran.summary["failed"]) == (4, 0)
    await until(lambda: len(asked) == 4)
    assert asked == [True, False, True, True]
    stage.listen("/light/_service_event", type_name=EVENT)
    ran = await stage.replay(file, "--json")  # played unchanged, but reported
    assert ran.summary["sent"] == len(lines)
    await until(lambda: len(stage.heard["/light/_service_event"]) == len(lines))
    assert len(asked) == 4


async def test_requests_that_nobody_serves_are_counted_as_not_sent(stage: Stage) -> None:
    lines = [event(0, ServiceEventInfo.REQUEST_RECEIVED, 1, value=True)]
    file = stage.bag(lines)
    ran = await stage.replay(file, "--publish-service-requests", "--topics", "/light", "--json")
    assert (ran.summary["sent"], ran.summary["failed"]) == (0, 1)


async def test_last_is_the_newest_recording_at_hand_of_any_robot_or_of_the_one_named(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    stage: Stage,
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.chdir(tmp_path)
    counts = {"robot_20260101_000000": 3, "robot_20260102_000000": 4, "r2_20270101_000000": 5}
    for name, count in counts.items():
        folder = tmp_path / "recordings" / name
        folder.mkdir(parents=True)
        write_bag(folder / f"{name}_0.mcap", talk("/alpha", count))
    ran = await stage.replay("last", "--json")
    assert ran.summary["sent"] == 5
    ran = await stage.replay("last", "--robot", "robot", "--json")
    assert ran.summary["sent"] == 4
    assert app.run(["replay", "last", "--robot", "r3"]) == 4
    assert "no recording of robot 'r3'" in capsys.readouterr().err


OLD = """\
- history: 3
  depth: 0
  reliability: 1
  durability: 1
  deadline: {sec: 2147483647, nsec: 4294967295}
  lifespan: {sec: 10, nsec: 0}
  liveliness: 1
"""


@pytest.mark.parametrize("offered", [QoSProfile(depth=7), LATCHED, SENSOR])
def test_our_own_recordings_give_back_what_was_offered(offered: QoSProfile) -> None:
    qos = replay_qos(to_yaml([offered]))
    assert (qos.reliability, qos.durability) == (offered.reliability, offered.durability)
    assert qos.depth >= offered.depth
    assert qos_check_compatible(qos, offered)[0] != QoSCompatibility.ERROR


def test_the_numbers_of_older_recorders_mean_the_same() -> None:
    qos = replay_qos(OLD)
    assert qos.reliability is ReliabilityPolicy.RELIABLE
    assert qos.durability is DurabilityPolicy.TRANSIENT_LOCAL
    assert qos.lifespan.nanoseconds == 10_000_000_000
    assert qos.deadline.nanoseconds == QoSProfile(depth=1).deadline.nanoseconds
    assert latched_depth(OLD) == 1


def test_of_several_publishers_the_strongest_counts_for_every_subscriber_to_match() -> None:
    qos = replay_qos(to_yaml([SENSOR]) + "\n" + to_yaml([LATCHED]) + "\n" + OLD)
    assert qos.reliability is ReliabilityPolicy.RELIABLE
    assert qos.durability is DurabilityPolicy.TRANSIENT_LOCAL
    assert qos.lifespan.nanoseconds == QoSProfile(depth=1).lifespan.nanoseconds
    for asked in (SENSOR, LATCHED, QoSProfile(depth=1)):
        assert qos_check_compatible(qos, asked)[0] != QoSCompatibility.ERROR


def test_at_full_speed_few_messages_are_kept_and_latched_ones_as_recorded() -> None:
    assert replay_qos(to_yaml([QoSProfile(depth=7)])).depth == VOLATILE_DEPTH
    assert replay_qos(to_yaml([QoSProfile(depth=7)]), most=5).depth == 5
    latched = to_yaml([QoSProfile(depth=7, durability=DurabilityPolicy.TRANSIENT_LOCAL)])
    assert replay_qos(latched, most=5).depth == 7


@pytest.mark.parametrize(
    "offered",
    ["", "[]", "- 3", "- history: [", "[" * 1000, "- {depth: -4, deadline: {sec: -1}}", "- a: b"],
)
def test_what_cannot_be_understood_is_reliable_and_volatile(offered: str) -> None:
    qos = replay_qos(offered)
    assert qos.reliability is ReliabilityPolicy.RELIABLE
    assert qos.durability is DurabilityPolicy.VOLATILE
    assert latched_depth(offered) == 0


def test_a_file_does_not_choose_how_much_memory_is_taken() -> None:
    assert replay_qos(f"- depth: {10**30}\n  durability: transient_local").depth == MAX_DEPTH
