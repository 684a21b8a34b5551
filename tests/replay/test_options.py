"""Each option of a replay, as other nodes in the domain see it."""

from __future__ import annotations

import json
import struct
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
from rclpy.serialization import serialize_message
from service_msgs.msg import ServiceEventInfo
from std_srvs.srv import SetBool

from tests.support.bags import (
    OTHER_HASH,
    START_NS,
    STRING,
    TWIST,
    Line,
    data,
    talk,
    twist,
    write_bag,
)

Until = Callable[[Callable[[], object]], Awaitable[None]]

CLOCK, EVENT = "rosgraph_msgs/msg/Clock", "std_srvs/srv/SetBool_Event"


def event(at_ms: float, kind: int, number: int, *, value: bool | None, client: int = 1) -> Line:
    """Return the introspection of a call of /light; `value` None is an answer."""
    info = ServiceEventInfo(event_type=kind, sequence_number=number)
    info.client_gid[:] = client
    requests = [] if value is None else [SetBool.Request(data=value)]
    content = serialize_message(SetBool.Event(info=info, request=requests))
    return Line("/light/_service_event", EVENT, at_ms, bytes(content))


async def test_topics_are_chosen_by_a_regular_expression_and_published_under_other_names(
    tmp_path: Path, listener: Any, replay: Any, until: Until
) -> None:
    lines = talk("/alpha", 10) + talk("/beta", 10) + talk("/gamma", 10)
    file = write_bag(tmp_path / "run.mcap", lines)
    for topic in ("/alpha", "/beta", "/gamma", "/other/beta"):
        listener.listen(topic, STRING)
    ran = await replay(
        file, "--regex", "^/b", "--topics", "gamma", "--remap", "beta:=other/beta",
        "--read-ahead", "1", "--delay", "0.1", "--json",
    )  # fmt: skip
    assert ran.exit_code == 0, ran.err
    await until(lambda: len(listener.heard["/other/beta"]) == len(listener.heard["/gamma"]) == 10)
    assert listener.heard["/other/beta"] == data(lines[10:20])
    assert listener.heard["/alpha"] == listener.heard["/beta"] == []
    published = {topic["name"]: topic["published"] for topic in ran.summary["topics"]}
    assert published == {"/beta": "/other/beta", "/gamma": "/gamma"}


async def test_what_is_remapped_onto_the_command_topic_is_withheld(
    tmp_path: Path, listener: Any, replay: Any
) -> None:
    commands = [Line("/old", TWIST, n, twist(1.0)) for n in range(10)]
    file = write_bag(tmp_path / "run.mcap", commands)
    listener.listen("/cmd_vel", TWIST)
    ran = await replay(file, "--remap", "/old:=/cmd_vel", "--json")
    assert ran.summary["withheld"] == {"/old": 10}
    assert listener.heard["/cmd_vel"] == []


async def test_a_type_that_has_changed_is_refused_unless_left_out_or_insisted_on(
    tmp_path: Path, listener: Any, replay: Any, until: Until
) -> None:
    alpha, beta = talk("/alpha", 5), talk("/beta", 5, type_hash=OTHER_HASH)
    file = write_bag(tmp_path / "run.mcap", alpha + beta)
    for topic in ("/alpha", "/beta"):
        listener.listen(topic, STRING)
    ran = await replay(file)
    assert (ran.exit_code, ran.out) == (4, "")
    assert "another definition than the installed one: /beta (std_msgs/msg/String)" in ran.err
    assert "/alpha" not in ran.err
    assert ran.err.count("\n") == 1
    ran = await replay(file, "--exclude", "/beta", "--json")
    assert (ran.exit_code, ran.summary["sent"]) == (0, 5)
    await until(lambda: listener.heard == {"/alpha": data(alpha), "/beta": []})
    ran = await replay(file, "--json")
    error = json.loads(ran.out)["error"]
    assert error["cure"] == "leave it out: --exclude NAME; play it anyway: --force-types"
    assert error["cause"].endswith("subscribers would misread it")
    ran = await replay(file, "--force-types", "--topics", "/beta", "--json")
    assert "--force-types plays it anyway" in ran.summary["notes"][0]
    await until(lambda: listener.heard["/beta"] == data(beta))


async def test_nothing_is_sent_before_the_subscribers_that_are_waited_for_are_there(
    tmp_path: Path, listener: Any, start: Any, until: Until
) -> None:
    alpha, beta = talk("/alpha", 20, 1.0), talk("/beta", 20, 1.0)
    file = write_bag(tmp_path / "run.mcap", alpha + beta)
    running = start(file, "--wait-for", "2", "--json")
    listener.listen("/alpha", STRING)
    await until(lambda: listener.node.count_publishers("/beta"))
    listener.listen("/beta", STRING)
    ran = await running.end()
    assert (ran.exit_code, ran.summary["sent"]) == (0, 40)
    await until(lambda: listener.heard == {"/alpha": data(alpha), "/beta": data(beta)})


async def test_an_interrupted_wait_for_subscribers_sends_nothing(
    tmp_path: Path, listener: Any, start: Any, until: Until
) -> None:
    file = write_bag(tmp_path / "run.mcap", talk("/alpha", 5))
    running = start(file, "--wait-for", "1", "--json")
    await until(lambda: listener.node.count_publishers("/alpha"))
    running.interrupt()
    ran = await running.end()
    assert (ran.exit_code, ran.summary["sent"]) == (130, 0)
    await until(lambda: listener.node.count_publishers("/alpha") == 0)


async def test_recorded_time_is_published_in_place_of_the_recorded_clock(
    tmp_path: Path, listener: Any, replay: Any, until: Until
) -> None:
    recorded = Line("/clock", CLOCK, 10.0, struct.pack("<4siI", b"\0\1", 1, 2))
    lines = [*talk("/alpha", 11, 50.0), recorded]
    file = write_bag(tmp_path / "run.mcap", lines)
    listener.listen("/clock", CLOCK)
    ran = await replay(file, "--clock", "50", "--json")
    assert ran.exit_code == 0, ran.err
    assert set(ran.summary["skipped"]) == {"/clock"}
    heard = listener.heard["/clock"]
    await until(lambda: len(heard) >= 3)
    times = [sec * 1_000_000_000 + ns for _, sec, ns in (struct.unpack("<4siI", d) for d in heard)]
    assert times == sorted(times)
    assert times[0] >= START_NS
    late_ns = round(ran.summary["timing_error_us"]["max"] * 1e3)
    assert times[-1] <= START_NS + 500_000_000 + late_ns  # it goes on until the last one is sent


async def test_a_second_clock_is_refused(tmp_path: Path, listener: Any, replay: Any) -> None:
    from rosgraph_msgs.msg import Clock

    file = write_bag(tmp_path / "run.mcap", talk("/alpha", 5))
    listener.node.create_publisher(Clock, "/clock", 10)
    ran = await replay(file, "--clock", "10")
    assert (ran.exit_code, ran.out) == (4, "")
    assert ran.err.startswith("robotctl: --clock is refused: /listener publishes /clock already")


async def test_recorded_requests_are_sent_once_each_to_the_service_that_is_named(
    tmp_path: Path, listener: Any, replay: Any, until: Until
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
    file = write_bag(tmp_path / "run.mcap", lines)
    asked: list[bool] = []

    def switch(request: Any, response: Any) -> Any:
        asked.append(request.data)
        return response

    listener.node.create_service(SetBool, "/light", switch)
    ran = await replay(file, "--publish-service-requests", "--json")
    assert ran.summary["withheld"] == {"/light/_service_event": len(lines)}
    assert "a robot would obey these requests" in ran.summary["notes"][0]
    ran = await replay(file, "--publish-service-requests", "--topics", "/light", "--json")
    assert (ran.summary["sent"], ran.summary["failed"]) == (4, 0)
    await until(lambda: len(asked) == 4)
    assert asked == [True, False, True, True]
    listener.listen("/light/_service_event", EVENT)
    ran = await replay(file, "--json")  # played unchanged, but reported
    assert ran.summary["sent"] == len(lines)
    await until(lambda: len(listener.heard["/light/_service_event"]) == len(lines))
    assert len(asked) == 4


async def test_requests_that_nobody_serves_are_counted_as_not_sent(
    tmp_path: Path, replay: Any
) -> None:
    lines = [event(0, ServiceEventInfo.REQUEST_RECEIVED, 1, value=True)]
    file = write_bag(tmp_path / "run.mcap", lines)
    ran = await replay(file, "--publish-service-requests", "--topics", "/light", "--json")
    assert (ran.summary["sent"], ran.summary["failed"]) == (0, 1)


async def test_last_is_the_newest_recording_at_hand_of_any_robot_or_of_the_one_named(
    tmp_path: Path, replay: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.chdir(tmp_path)
    counts = {"robot_20260101_000000": 3, "robot_20260102_000000": 4, "r2_20270101_000000": 5}
    for name, count in counts.items():
        folder = tmp_path / "recordings" / name
        folder.mkdir(parents=True)
        write_bag(folder / f"{name}_0.mcap", talk("/alpha", count))
    ran = await replay("last", "--json")
    assert ran.summary["sent"] == 5
    ran = await replay("last", "--robot", "robot", "--json")
    assert ran.summary["sent"] == 4
    ran = await replay("last", "--robot", "r3")
    assert ran.exit_code == 4
    assert "no recording of robot 'r3'" in ran.err


async def test_one_recording_at_a_time_is_played(tmp_path: Path, replay: Any) -> None:
    file = write_bag(tmp_path / "run.mcap", talk("/alpha", 3))
    ran = await replay(file, file)
    assert ran.exit_code == 2
    assert "give their folder" in ran.err
