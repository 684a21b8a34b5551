"""Listen to one topic, and report its serialized messages."""

from __future__ import annotations

import asyncio
import base64
from typing import Any

from robotctl.errors import Refused, UsageError
from robotctl.ros.executor import AsyncioExecutor, RawTap
from robotctl.ros.graph import endpoints
from robotctl.ros.messages import qos
from robotctl.ros.messages.classes import NO_SUBSCRIPTION_EVENTS, UnusableType, message_class
from robotctl.ros.messages.type_definition import definition_of, holds_bytes
from robotctl.ros.queries.visitor import Send, Visitor
from robotctl.unknown_name import only_type, unknown_name


async def listen(visitor: Visitor, request: dict[str, Any], send: Send) -> None:
    """Report type and definition of a topic, then each message, until cancelled.

    The first report is {"type", "definition", "publishers"}; then {"received_ns", "source_ns",
    "size", "publisher"}, and "data" in base64 if the request wants it.

    Raises:
        UsageError: The name cannot be a topic's; or the topic is unknown, or has several types, of
            which the request names none.
        Refused: Its type is not installed here.
    """
    node, topic = visitor.node, request["name"]
    if not endpoints.is_topic_name(topic):
        cure = "use letters, digits, _ and /, and no digit after a /"
        raise UsageError(f"{topic!r} is no name of a topic in ROS", cure)
    known = visitor.discover(
        lambda: bool(endpoints.publishers(node, topic)), expected=request["expected"]
    )
    offered = endpoints.publishers(node, topic)
    subscribed = endpoints.subscriptions(node, topic)
    if not known and not subscribed and not request["type"]:
        names = [name for name in endpoints.topics(node) if endpoints.publishers(node, name)]
        raise UsageError(*unknown_name("topic", topic, names))
    known_types = {each.topic_type for each in (*offered, *subscribed)}
    type_name = request["type"] or only_type(topic, known_types)
    try:
        kind = message_class(type_name)
    except UnusableType as error:
        raise Refused(
            f"{topic} has type {type_name}, which {error}", "install its package"
        ) from None
    definition = definition_of(type_name)
    send({"type": type_name, "definition": definition, "publishers": len(offered)})

    def report(data: bytes, received_ns: int, source_ns: int, _: int, gid: bytes) -> None:
        told: dict[str, Any] = {
            "received_ns": received_ns,
            "source_ns": source_ns,
            "size": len(data),
            "publisher": gid.hex(),
        }
        if request["data"]:
            told["data"] = base64.b64encode(data).decode()
        send(told)

    failed: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    def fail(error: BaseException, _: str) -> None:
        if not failed.done():
            failed.set_exception(error)

    callback: Any = RawTap(report, latency_s=0.0)
    profiles = [each.qos_profile for each in offered if each.topic_type == type_name]
    wanted = qos.recording(profiles, bulky=holds_bytes(type_name)) if profiles else qos.MONITOR
    node.create_subscription(
        kind, topic, callback, wanted, event_callbacks=NO_SUBSCRIPTION_EVENTS, raw=True
    )
    async with AsyncioExecutor(visitor.context, on_exception=fail) as executor:
        executor.add_node(node)
        await failed
