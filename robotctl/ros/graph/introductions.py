"""The announcements of ROS processes: a reader and a writer of `ros_discovery_info`.

On this DDS topic each process tells which endpoints its nodes have. rcl allows no topic without a
leading slash, so both are made by rmw.
"""

from __future__ import annotations

import ctypes
import struct
from functools import cache
from typing import Any, Final, NamedTuple

from rclpy.node import Node

from robotctl.cdr.reader import CdrReader
from robotctl.ros.executor import RclCallFailed, rcutils
from robotctl.ros.graph.publishers import PROCESS_BYTES
from robotctl.ros.graph.rmw_structs import GID_BYTES, PublisherOptions, Qos, SubscriptionOptions
from robotctl.ros.graph.rmw_structs import Time as RmwTime

TOPIC: Final = "ros_discovery_info"

_TYPE: Final = "rmw_dds_common__msg__ParticipantEntitiesInfo"
_READ_DEPTH: Final = 1000
_KEEP_LAST: Final = 1
_RELIABLE: Final = 1
_TRANSIENT_LOCAL: Final = 1
_TIMEOUT: Final = 2


class Introduction(NamedTuple):
    """What a process announced last: its prefix of gids, its endpoints, and the message itself."""

    process: bytes
    endpoints: frozenset[bytes]
    data: bytes


class IntroductionReader:
    """The last introduction of each process in the domain, this one included."""

    def __init__(self, node: Node) -> None:
        """Read as `node`.

        Raises:
            RclCallFailed: The middleware does not allow it.
        """
        self.by_process: dict[bytes, Introduction] = {}
        self._node = node
        self._message = rcutils.SerializedMessage(allocator=rcutils.default_allocator())
        options = _function("rmw_get_default_subscription_options", SubscriptionOptions)()
        self._reader = _create(node, "rmw_create_subscription", _qos(_READ_DEPTH), options)

    def look(self) -> None:
        """Take what has arrived."""
        while (data := self._take()) is not None:
            try:
                found = read_introduction(data)
            except struct.error:  # of a process that is no ROS process
                continue
            self.by_process[found.process] = found

    def close(self) -> None:
        """Remove the reader from the graph."""
        _destroy(self._node, "rmw_destroy_subscription", self._reader)
        rcutils.library().rcutils_uint8_array_fini(ctypes.byref(self._message))

    def _take(self) -> bytes | None:
        taken = ctypes.c_bool(False)
        take = _function("rmw_take_serialized_message", ctypes.c_int)
        code = take(self._reader, ctypes.byref(self._message), ctypes.byref(taken), None)
        if code:
            raise RclCallFailed(f"rmw_take_serialized_message failed with {code}")
        message = self._message
        return ctypes.string_at(message.buffer, message.length) if taken.value else None


class IntroductionWriter:
    """Announces this process again, to learn whether others know its endpoints.

    The middleware tells other processes of our publishers in the order in which they were made,
    and this one is the last: a process that has acknowledged its message knows all others.
    """

    def __init__(self, node: Node) -> None:
        """Write as `node`; create it after all publishers that others must know.

        Raises:
            RclCallFailed: The middleware does not allow it.
        """
        self._node = node
        options = _function("rmw_get_default_publisher_options", PublisherOptions)()
        self._writer = _create(node, "rmw_create_publisher", _qos(1), options)

    def write(self, data: bytes) -> None:
        """Announce this process with its own last introduction."""
        memory = ctypes.create_string_buffer(data, len(data))
        message = rcutils.SerializedMessage(
            buffer=ctypes.addressof(memory),
            length=len(data),
            capacity=len(data),
            allocator=rcutils.default_allocator(),
        )
        _checked("rmw_publish_serialized_message", self._writer, ctypes.byref(message), None)

    def is_acknowledged(self) -> bool:
        """Return whether all processes have acknowledged what was written."""
        wait = _function("rmw_publisher_wait_for_all_acked", ctypes.c_int)
        code = wait(self._writer, RmwTime(0, 0))
        if code == _TIMEOUT:
            rcutils.take_error_text()
        return bool(code == 0)

    def close(self) -> None:
        """Remove the writer from the graph."""
        _destroy(self._node, "rmw_destroy_publisher", self._writer)


def read_introduction(data: bytes) -> Introduction:
    """Read a rmw_dds_common/ParticipantEntitiesInfo.

    Raises:
        struct.error: It is not one.
    """
    reader = CdrReader(data)
    process = reader.octets(GID_BYTES)[:PROCESS_BYTES]
    endpoints: set[bytes] = set()
    for _node in range(*reader.take("I")):
        for _name in range(2):
            reader.octets(*reader.take("I"))
        for _role in range(2):
            gids = reader.octets(GID_BYTES * reader.take("I")[0])
            endpoints.update(
                gids[begin : begin + GID_BYTES] for begin in range(0, len(gids), GID_BYTES)
            )
    return Introduction(process, frozenset(endpoints), data)


@cache
def _function(name: str, restype: Any) -> Any:
    """Return a function of rmw, which librcl has loaded."""
    function = ctypes.PyDLL("librcl.so")[name]
    function.restype = restype
    return function


@cache
def _type_support() -> ctypes.c_void_p:
    library = ctypes.PyDLL("librmw_dds_common__rosidl_typesupport_c.so")
    function = library[f"rosidl_typesupport_c__get_message_type_support_handle__{_TYPE}"]
    function.restype = ctypes.c_void_p
    return ctypes.c_void_p(function())


def _qos(depth: int) -> Qos:
    return Qos(
        history=_KEEP_LAST,
        depth=depth,
        reliability=_RELIABLE,
        durability=_TRANSIENT_LOCAL,
        avoid_ros_namespace_conventions=True,
    )


def _create(node: Node, function: str, qos: Qos, options: ctypes.Structure) -> ctypes.c_void_p:
    create = _function(function, ctypes.c_void_p)
    with node.handle:
        made = create(
            _rmw_node(node),
            _type_support(),
            ctypes.c_char_p(TOPIC.encode()),
            ctypes.byref(qos),
            ctypes.byref(options),
        )
    if not made:
        raise RclCallFailed(f"{function} failed: {rcutils.take_error_text()}")
    return ctypes.c_void_p(made)


def _destroy(node: Node, function: str, made: ctypes.c_void_p) -> None:
    with node.handle:
        _checked(function, _rmw_node(node), made)


def _rmw_node(node: Node) -> ctypes.c_void_p:
    handle = _function("rcl_node_get_rmw_handle", ctypes.c_void_p)
    return ctypes.c_void_p(handle(ctypes.c_void_p(node.handle.pointer)))


def _checked(function: str, *arguments: Any) -> None:
    code = _function(function, ctypes.c_int)(*arguments)
    if code:
        raise RclCallFailed(f"{function} failed with {code}: {rcutils.take_error_text()}")
