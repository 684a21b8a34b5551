"""The queries (see `queries`) that exchange messages: call a service, listen to a topic."""

from __future__ import annotations

import asyncio
import base64
from collections.abc import Callable, Coroutine
from typing import Any

from rclpy.serialization import deserialize_message, serialize_message

from robotctl.base.errors import NoDaemon, Refused, UsageError
from robotctl.base.unknown_name import only_type, unknown_name
from robotctl.messages.definition import Definition, UnreadableType, parse_definition
from robotctl.messages.fields import WrongValue
from robotctl.messages.installed import UnusableType, installed_type
from robotctl.messages.values import Decoder, encode, filled
from robotctl.ros import qos
from robotctl.ros.context import STDIN, Membership
from robotctl.ros.executor import AsyncioExecutor, RawTap
from robotctl.ros.graph import endpoints
from robotctl.ros.graph.endpoints import services
from robotctl.ros.message_types import message_class, subscribe_raw

Send = Callable[[dict[str, Any]], None]
"""Sends a report, a JSON object, to the command."""


def run(work: Coroutine[Any, Any, None]) -> None:
    """Run `work` in an event loop until it is done, or until stdin is closed.

    Raises:
        asyncio.CancelledError: Stdin was closed.
    """
    asyncio.run(_until_stdin_ends(work))


async def _until_stdin_ends(work: Coroutine[Any, Any, None]) -> None:
    loop, task = asyncio.get_running_loop(), asyncio.ensure_future(work)

    def end() -> None:
        loop.remove_reader(STDIN)
        task.cancel()

    loop.add_reader(STDIN, end)
    try:
        await task
    finally:
        loop.remove_reader(STDIN)


async def call(visitor: Membership, request: dict[str, Any], send: Send) -> None:
    """Call a service, and report the response as {"type", "definition", "data"}, "data" in base64.

    Raises:
        NoDaemon: The service does not appear in time, or does not answer.
        UsageError: The service has another type or several, or a value does not fit the type.
        Refused: The service's type is not installed here, or cannot be read.
    """
    node, name = visitor.node, request["name"]
    visitor.discover(lambda: name in services(node), expected=request["expected"])
    known = services(node)
    if name not in known and not request["type"]:
        raise NoDaemon(*unknown_name("service", name, known))
    type_name = _type_of(name, request["type"], sorted(known.get(name, ())))
    try:
        kind, request_class = message_class(type_name), message_class(f"{type_name}_Request")
    except UnusableType as error:
        raise Refused(f"the service's type {type_name} {error}", "install its package") from None
    message = _message(f"{type_name}_Request", request_class, request["values"])
    client = node.create_client(kind, name)
    async with AsyncioExecutor(visitor.node.context) as executor:
        executor.add_node(node)
        try:
            await executor.wait_for_service(client, timeout_s=request["wait_s"])
        except TimeoutError:
            raise NoDaemon(
                f"no process serves {name} as {type_name} within {request['wait_s']:g} s",
                "see: robotctl service list",
            ) from None
        try:
            response = await executor.call(client, message, timeout_s=request["answer_s"])
        except TimeoutError:
            raise NoDaemon(
                f"{name} did not answer within {request['answer_s']:g} s",
                "wait longer with --timeout",
            ) from None
    response_type = f"{type_name}_Response"
    send(
        {
            "type": response_type,
            "definition": installed_type(response_type).text,
            "data": base64.b64encode(serialize_message(response)).decode(),
        }
    )


def _type_of(name: str, wanted: str, types: list[str]) -> str:
    """Return the type of the service: `wanted` or, if that is "", the only one of `types`.

    Raises:
        UsageError: `types` lacks the wanted type, or has several while `wanted` is "".
    """
    if wanted and types and wanted not in types:
        raise UsageError(f"{name} has type {', '.join(types)}, not {wanted}", "leave the type out")
    if wanted or len(types) == 1:
        return wanted or types[0]
    raise UsageError(f"{name} has several types: {', '.join(types)}", "name one before the values")


def _message(type_name: str, kind: Any, values: Any) -> Any:
    """Return a request message of class `kind` with the given values.

    Raises:
        UsageError: A value does not fit the type.
    """
    definition = _definition(type_name)
    defaults = Decoder(definition).values(serialize_message(kind()))
    try:
        return deserialize_message(encode(definition, filled(definition, defaults, values)), kind)
    except WrongValue as error:
        raise UsageError(str(error)) from None


def _definition(type_name: str) -> Definition:
    try:
        return parse_definition(type_name, installed_type(type_name).text)
    except UnreadableType as error:
        raise Refused(f"{type_name} cannot be read: {error}") from None


async def listen(visitor: Membership, request: dict[str, Any], send: Send) -> None:
    """Report type and definition of a topic, then each message, until cancelled.

    The first report is {"type", "definition", "publishers"}. Each message is {"received_ns",
    "source_ns", "size", "publisher"}, with "data" in base64 if the request asks for data.

    Raises:
        UsageError: The name is not a valid topic name, the topic is unknown, or the topic has
            several types and the request names none.
        Refused: The topic's type is not installed here, or its definition cannot be read.
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
    installed = installed_type(type_name)
    if request["data"]:
        _definition(type_name)
    send({"type": type_name, "definition": installed.text, "publishers": len(offered)})

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

    profiles = [each.qos_profile for each in offered if each.topic_type == type_name]
    wanted = qos.recording(profiles, bulky=installed.holds_bytes) if profiles else qos.MONITOR
    subscribe_raw(node, kind, topic, RawTap(report, latency_s=0.0), wanted)
    async with AsyncioExecutor(visitor.node.context, on_exception=fail) as executor:
        executor.add_node(node)
        await failed
