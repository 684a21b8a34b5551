"""The tap follows the graph: topics, types and publishers come and go.

Changes of the graph are announced, and a calm graph wakes nobody.
Who publishes a message is named, also before its publisher is announced.
"""

from __future__ import annotations

import asyncio
import os
import re
import resource
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import pytest
from rclpy.action.server import ActionServer
from rclpy.node import Node
from rclpy.service_introspection import ServiceIntrospectionState
from robot_controller.action import DrivePattern
from robot_controller.srv import SetMode
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from std_msgs.msg import String, UInt64

from robotctl.ros import qos
from robotctl.ros.executor import announcements
from robotctl.ros.graph.discovery import GraphChanges
from robotctl.ros.graph.endpoints import PROCESS_BYTES, gid_of, node_of
from robotctl.ros.session import Session
from robotctl.ros.tap import tap
from robotctl.ros.tap.tap import Tap
from tests.ros.conftest import Taken
from tests.support.waiting import DEADLINE_S
from tests.support.waiting import loop_until as until

MANY = 150


@pytest.fixture
def other_node(new_context: Callable[[], Any]) -> Iterator[Any]:
    """A node of another participant; one participant has one type per topic."""
    made = Node("other", context=new_context())
    yield made
    made.destroy_node()


def publisher(node: Any, topic: str, profile: Any = 10) -> Any:
    return node.create_publisher(UInt64, topic, profile)


def text_publisher(node: Any, topic: str) -> Any:
    return node.create_publisher(String, topic, 10)


def number(value: int) -> Any:
    return UInt64(data=value)


async def look_until(tap: Tap, condition: Callable[[], object]) -> None:
    """Let a tap look repeatedly: it must load new types first."""
    async with asyncio.timeout(DEADLINE_S):
        while not condition():
            await tap._look()
            await asyncio.sleep(0.005)


# Topics


async def test_a_topic_that_vanishes_and_comes_back_is_taken_again(
    taken: Any, other_node: Any, topic: str
) -> None:
    for value in (1, 2):
        published = publisher(other_node, topic)
        await until(published.get_subscription_count)
        published.publish(number(value))

        def is_taken(value: int = value) -> bool:
            return bool(taken.values(topic)[-1:] == [value])

        await until(is_taken)
        other_node.destroy_publisher(published)
    sequences = [message[3] for message in taken.messages[topic]]
    assert sequences == [1, 1]
    assert len({message[4] for message in taken.messages[topic]}) == 2  # it is another publisher


async def test_in_a_calm_graph_the_announcement_of_rcl_alone_finds_a_topic(
    taken: Any, other_node: Any, topic: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    long_s = 1000.0
    monkeypatch.setattr(tap, "CALM_S", long_s)
    monkeypatch.setattr(tap, "LOOKS_PER_INSPECTION", 2)
    waits: list[float] = []
    wait = GraphChanges.wait

    async def noted(changes: GraphChanges, at_most_s: float) -> bool:
        waits.append(at_most_s)
        return await wait(changes, at_most_s)

    monkeypatch.setattr(GraphChanges, "wait", noted)
    await until(lambda: waits[-1:] == [long_s])
    publisher(other_node, topic)
    await until(lambda: topic in taken.topics)


async def test_a_topic_that_comes_back_with_another_type_is_taken_as_that(
    taken: Any, other_node: Any, topic: str
) -> None:
    first = publisher(other_node, topic)
    await until(first.get_subscription_count)
    other_node.destroy_publisher(first)
    second = text_publisher(other_node, topic)
    await until(second.get_subscription_count)
    second.publish(String(data="as text"))
    await until(lambda: taken.messages[topic])
    assert taken.topics[topic].type_name == "std_msgs/msg/String"
    assert b"as text" in taken.messages[topic][0][0]
    await until(lambda: not taken.tap.unrecorded.by_topic)


async def test_a_topic_that_nobody_publishes_for_long_is_given_back(
    taken: Any, other_node: Any, topic: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    published = publisher(other_node, topic)
    await until(published.get_subscription_count)
    other_node.destroy_publisher(published)
    await until(lambda: other_node.count_publishers(topic) == 0)
    assert other_node.count_subscribers(topic) == 1  # it may come back at any moment
    monkeypatch.setattr(tap, "ABANDONED_S", 0.0)
    await until(lambda: other_node.count_subscribers(topic) == 0)


async def test_of_several_types_the_most_published_is_taken_and_others_are_named_until_they_go(
    session: Session, node: Any, other_node: Any, topic: str
) -> None:
    other = text_publisher(other_node, topic)
    kept = [publisher(node, topic), publisher(node, topic), other]
    taken = Taken()
    tap = Tap(session, taken.open)
    await until(lambda: len(tap.node.get_publishers_info_by_topic(topic)) == len(kept))
    await look_until(tap, lambda: topic in taken.topics)
    assert taken.topics[topic].type_name == "std_msgs/msg/UInt64"
    assert tap.unrecorded.by_topic == {
        topic: f"{topic} is recorded as std_msgs/msg/UInt64, not as std_msgs/msg/String"
    }
    other_node.destroy_publisher(other)
    await look_until(tap, lambda: not tap.unrecorded.by_topic)


async def test_what_is_not_wanted_is_left_alone(taken: Any, node: Any, topic: str) -> None:
    taken.unwanted = {f"{topic}_a", "std_msgs/msg/String"}
    publisher(node, f"{topic}_a")
    text_publisher(node, f"{topic}_b")
    publisher(node, f"{topic}_c")  # topics are looked at in the order of their names
    await until(lambda: f"{topic}_c" in taken.topics)
    assert not {f"{topic}_a", f"{topic}_b"} & taken.topics.keys()
    assert taken.tap.unrecorded.by_topic == {}


async def test_hidden_topics_are_taken_but_for_the_executors_own(
    taken: Any, node: Any, topic: str
) -> None:
    hidden = topic.replace("/", "/_")
    own = f"{announcements.TOPIC_PREFIX}4711"
    publisher(node, own)
    published = publisher(node, hidden)
    await until(published.get_subscription_count)
    published.publish(number(3))
    await until(lambda: taken.messages[hidden])
    publisher(node, topic)
    await until(lambda: topic in taken.topics)
    assert own not in taken.topics


async def test_the_feedback_and_the_status_of_an_action_are_taken(
    taken: Any, node: Any, topic: str
) -> None:
    server = ActionServer(node, DrivePattern, topic, lambda handle: None)
    feedback, status = f"{topic}/_action/feedback", f"{topic}/_action/status"
    await until(lambda: {feedback, status} <= taken.topics.keys())
    assert taken.topics[status].type_name == "action_msgs/msg/GoalStatusArray"
    assert "durability: transient_local" in taken.topics[status].offered_qos
    server.destroy()


async def test_the_events_of_a_service_are_taken_with_a_schema_that_decodes_them(
    taken: Any, executor: Any, node: Any, topic: str
) -> None:
    def answer(request: Any, response: Any) -> Any:
        response.message = "because"
        return response

    service = node.create_service(SetMode, topic, answer)
    service.configure_introspection(
        node.get_clock(), qos.SERVICE_EVENTS, ServiceIntrospectionState.CONTENTS
    )
    events = f"{topic}/_service_event"
    await until(lambda: events in taken.topics)
    await until(lambda: node.count_subscribers(events) == 1)
    client = node.create_client(SetMode, topic)
    await executor.wait_for_service(client, timeout_s=20.0)
    await executor.call(client, SetMode.Request(requested_mode=3), timeout_s=20.0)
    await until(lambda: len(taken.messages[events]) == 2)
    described = taken.topics[events]
    assert described.type_name == "robot_controller/srv/SetMode_Event"
    (info,) = node.get_publishers_info_by_topic(events)
    assert described.type_hash == str(info.topic_type_hash)
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(described.definition, described.type_name))
    taken_events: list[Any] = [
        store.deserialize_cdr(message[0], "robot_controller/srv/msg/SetMode_Event")
        for message in taken.messages[events]
    ]
    asked, answered = taken_events
    assert (asked.info.event_type, asked.request[0].requested_mode) == (1, 3)
    assert (answered.info.event_type, answered.response[0].message) == (2, "because")


# Publishers


async def test_a_publisher_that_is_replaced_by_one_that_offers_less_is_taken_as_well(
    taken: Any, node: Any, other_node: Any, topic: str
) -> None:
    steady, first = publisher(node, topic), publisher(other_node, topic)
    await until(lambda: steady.get_subscription_count() and first.get_subscription_count())
    other_node.destroy_publisher(first)
    weaker = publisher(other_node, topic, qos.SENSOR)
    await until(weaker.get_subscription_count)
    weaker.publish(number(7))
    await until(lambda: 7 in taken.values(topic))


async def test_what_one_publisher_has_latched_is_taken_though_another_latches_nothing(
    taken: Any, node: Any, other_node: Any, topic: str
) -> None:
    latching, plain = publisher(node, topic, qos.LATCHED), publisher(other_node, topic)
    latching.publish(number(1))
    await until(lambda: topic in taken.topics and 1 in taken.values(topic))
    await until(lambda: plain.get_subscription_count() == 1)
    await until(lambda: latching.get_subscription_count() == 2)
    plain.publish(number(2))
    latching.publish(number(3))
    await until(lambda: {2, 3} <= set(taken.values(topic)))
    assert sorted(taken.values(topic)) == [1, 2, 3]


def _open_files() -> set[str]:
    """Return what each open file of this process is."""
    found = set()
    for number in os.listdir("/proc/self/fd"):
        with suppress(FileNotFoundError):  # the one that lists them
            told = Path(f"/proc/self/fdinfo/{number}").read_text()
            identity = "".join(re.findall("eventfd-id.*", told))
            found.add(f"{os.readlink(f'/proc/self/fd/{number}')} {identity}")
    return found


@pytest.fixture
def held_files() -> Iterator[None]:
    """Keep what earlier tests left open: a new file would be taken for one that closes."""
    with ExitStack() as copies:
        for number in os.listdir("/proc/self/fd"):
            with suppress(OSError):  # the one that lists them
                copies.callback(os.close, os.dup(int(number)))
        yield


@pytest.mark.usefixtures("held_files")
async def test_hundreds_of_topics_take_one_file_each(
    taken: Any, other_node: Any, topic: str
) -> None:
    files = _open_files()
    published = [publisher(other_node, f"{topic}_{index}") for index in range(MANY)]
    await until(lambda: all(each.get_subscription_count() for each in published))
    for index, each in enumerate(published):
        each.publish(number(index))
    await until(lambda: all(taken.values(f"{topic}_{index}") == [index] for index in range(MANY)))
    assert MANY <= len(_open_files() - files) < MANY + 20


async def test_a_topic_too_many_is_named_and_the_process_keeps_its_files(
    session: Session,
    node: Any,
    topic: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda what: (2, 2))
    taken = Taken()
    tap = Tap(session, taken.open)
    kept = [publisher(node, f"{topic}_{index}") for index in range(2)]
    await until(lambda: all(tap.node.count_publishers(each.topic_name) for each in kept))
    await look_until(tap, lambda: tap.unrecorded.by_topic)
    assert len(taken.topics) == 1
    (problem, *_) = tap.unrecorded.by_topic.values()
    assert "there are more topics than 2 open files allow (see ulimit -n)" in problem


async def settled(changes: GraphChanges) -> None:
    """Wait until nothing of earlier tests changes the graph any more."""
    async with asyncio.timeout(DEADLINE_S):
        while await changes.wait(0.5):
            pass


async def test_a_topic_of_another_process_is_a_change_and_a_calm_graph_has_none(
    node: Any, new_context: Callable[[], Any]
) -> None:
    other = Node("other", context=new_context())
    with GraphChanges(node) as changes:
        await settled(changes)
        published = other.create_publisher(UInt64, "changing", 10)
        assert await changes.wait(DEADLINE_S)
        await settled(changes)
        other.destroy_publisher(published)
        assert await changes.wait(DEADLINE_S)
    other.destroy_node()


async def test_a_change_before_the_wait_is_not_missed(node: Any) -> None:
    with GraphChanges(node) as changes:
        await settled(changes)
        node.create_publisher(UInt64, "early", 10)
        await asyncio.sleep(0)
        assert await changes.wait(DEADLINE_S)


async def test_its_thread_ends_with_the_block_whatever_it_waits_for(node: Any) -> None:
    with GraphChanges(node) as changes:
        await settled(changes)  # the thread waits for a change
    with GraphChanges(node):
        node.create_publisher(UInt64, "late", 10)  # the thread waits to be asked
    assert "graph changes" not in {thread.name for thread in threading.enumerate()}


def test_a_publisher_that_is_not_announced_yet_has_the_name_of_the_only_node_of_its_process(
    new_context: Callable[[], Any],
) -> None:
    context = new_context()
    planner = Node("planner", namespace="/front", context=context)
    gid = gid_of(planner.create_publisher(String, "/told", 1))
    later, stranger = gid[:PROCESS_BYTES] + b"\xee\xee\xee\x03", bytes(16)
    assert node_of(planner, "/told", gid) == "/front/planner"
    assert node_of(planner, "/told", later) == "/front/planner"
    assert node_of(planner, "/told", stranger) == ""

    other = Node("other", context=context)
    assert node_of(planner, "/told", gid) == "/front/planner"
    assert node_of(planner, "/told", later) == ""
    other.destroy_node()
    planner.destroy_node()
