"""Call a service once, and report its response."""

from __future__ import annotations

import base64
from typing import Any

from rclpy.serialization import deserialize_message, serialize_message

from robotctl.cdr.definition import Definition, UnreadableType, parse_definition
from robotctl.cdr.given import WrongValue, filled
from robotctl.cdr.values import decode, encode
from robotctl.errors import NoDaemon, Refused, UsageError
from robotctl.ros.executor import AsyncioExecutor
from robotctl.ros.graph.overview import services
from robotctl.ros.messages.classes import UnusableType, message_class
from robotctl.ros.messages.type_definition import definition_of
from robotctl.ros.queries.visitor import Send, Visitor
from robotctl.unknown_name import unknown_name


async def call(visitor: Visitor, request: dict[str, Any], send: Send) -> None:
    """Report {"type", "definition", "data"} of the response, the data in base64.

    Raises:
        NoDaemon: No such service appears in time, or it does not answer.
        UsageError: It has another type, or a value does not fit the type.
        Refused: Its type is not installed here.
    """
    node, name = visitor.node, request["name"]
    visitor.discover(lambda: name in services(node), expected=request["expected"])
    known = services(node)
    if name not in known and not request["type"]:
        raise NoDaemon(*unknown_name("service", name, known))
    type_name = _type_of(name, request["type"], sorted(known.get(name, ())))
    kind, request_class = _classes(type_name)
    message = _message(f"{type_name}_Request", request_class, request["values"])
    client = node.create_client(kind, name)
    async with AsyncioExecutor(visitor.context) as executor:
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
            "definition": definition_of(response_type),
            "data": base64.b64encode(serialize_message(response)).decode(),
        }
    )


def _type_of(name: str, wanted: str, types: list[str]) -> str:
    """Return the type to call the service with.

    Raises:
        UsageError: It is not the wanted one, or there are several.
    """
    if wanted and types and wanted not in types:
        raise UsageError(f"{name} has type {', '.join(types)}, not {wanted}", "leave the type out")
    if wanted or len(types) == 1:
        return wanted or types[0]
    raise UsageError(f"{name} has several types: {', '.join(types)}", "name one before the values")


def _classes(type_name: str) -> tuple[Any, Any]:
    """Return the classes of the service and of its request.

    Raises:
        Refused: The package of the type is not installed.
    """
    try:
        return message_class(type_name), message_class(f"{type_name}_Request")
    except UnusableType as error:
        raise Refused(f"the service's type {type_name} {error}", "install its package") from None


def _message(type_name: str, kind: Any, values: Any) -> Any:
    """Return a request with the given values.

    Raises:
        UsageError: A value does not fit.
    """
    definition = _definition(type_name)
    defaults = decode(definition, serialize_message(kind()))
    try:
        return deserialize_message(encode(definition, filled(definition, defaults, values)), kind)
    except WrongValue as error:
        raise UsageError(str(error)) from None


def _definition(type_name: str) -> Definition:
    try:
        return parse_definition(type_name, definition_of(type_name))
    except UnreadableType as error:
        raise Refused(f"{type_name} cannot be read: {error}") from None
