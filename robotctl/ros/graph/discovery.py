"""Waiting for discovery between this process and all others in a ROS domain.

Each process announces its nodes' endpoints on the DDS topic `ros_discovery_info`, here called its
introduction.
"""

from __future__ import annotations

import asyncio
import ctypes
import struct
import threading
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from functools import cache
from typing import Final, NamedTuple, Self

from rclpy.guard_condition import GuardCondition
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, ReliabilityPolicy

from robotctl.base.domains import is_on_this_machine_only, participants_here
from robotctl.messages.cdr import CdrReader
from robotctl.ros.executor import RclCallFailed, rcutils
from robotctl.ros.graph import endpoints
from robotctl.ros.graph.endpoints import PROCESS_BYTES, gid_of
from robotctl.ros.graph.rcl_graph import (
    GID_BYTES,
    PublisherOptions,
    Qos,
    SubscriptionOptions,
    checked,
    function,
)
from robotctl.ros.graph.rcl_graph import Time as RmwTime

TOPIC: Final = "ros_discovery_info"

_TYPE: Final = "rmw_dds_common__msg__ParticipantEntitiesInfo"
_READ_DEPTH: Final = 1000
_TIMEOUT: Final = 2


class Introduction(NamedTuple):
    """The last announcement of a process on `ros_discovery_info`."""

    process: bytes
    """The prefix of the gids of the process's endpoints."""
    endpoints: frozenset[bytes]
    """The gids of the endpoints."""
    data: bytes
    """The serialized message."""


class IntroductionReader:
    """Keeps the last announcement on `ros_discovery_info` of each process, also of this one."""

    def __init__(self, node: Node) -> None:
        """Create the reader on `node`.

        Raises:
            RclCallFailed: The middleware could not create the reader.
        """
        self.by_process: dict[bytes, Introduction] = {}
        self._node = node
        self._message = rcutils.SerializedMessage(allocator=rcutils.default_allocator())
        options = function("rmw_get_default_subscription_options", SubscriptionOptions)()
        self._reader = _create(node, "rmw_create_subscription", _qos(_READ_DEPTH), options)

    def look(self) -> None:
        """Read the announcements that have arrived since the last call."""
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
        take = function("rmw_take_serialized_message")
        code = take(self._reader, ctypes.byref(self._message), ctypes.byref(taken), None)
        if code:
            raise RclCallFailed(f"rmw_take_serialized_message failed with {code}")
        message = self._message
        return ctypes.string_at(message.buffer, message.length) if taken.value else None


class IntroductionWriter:
    """Repeats this process's announcement. Who acknowledges it knows our earlier publishers."""

    def __init__(self, node: Node) -> None:
        """Create the writer on `node`, after all publishers that others must know.

        Raises:
            RclCallFailed: The middleware could not create the writer.
        """
        self._node = node
        # Created last, so that a process that acknowledges it knows all our earlier publishers.
        options = function("rmw_get_default_publisher_options", PublisherOptions)()
        self._writer = _create(node, "rmw_create_publisher", _qos(1), options)

    def write(self, data: bytes) -> None:
        """Announce this process again. `data` is its last announcement, serialized."""
        memory = ctypes.create_string_buffer(data, len(data))
        message = rcutils.SerializedMessage(
            buffer=ctypes.addressof(memory),
            length=len(data),
            capacity=len(data),
            allocator=rcutils.default_allocator(),
        )
        checked("rmw_publish_serialized_message", self._writer, ctypes.byref(message), None)

    def is_acknowledged(self) -> bool:
        """Return whether all discovered processes have acknowledged the last announcement."""
        code = function("rmw_publisher_wait_for_all_acked")(self._writer, RmwTime(0, 0))
        if code == _TIMEOUT:
            rcutils.take_error_text()
        return bool(code == 0)

    def close(self) -> None:
        """Remove the writer from the graph."""
        _destroy(self._node, "rmw_destroy_publisher", self._writer)


def read_introduction(data: bytes) -> Introduction:
    """Return the content of a serialized rmw_dds_common/ParticipantEntitiesInfo.

    Raises:
        struct.error: `data` is cut short, or is not such a message.
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
def _type_support() -> ctypes.c_void_p:
    library = ctypes.PyDLL("librmw_dds_common__rosidl_typesupport_c.so")
    handle = library[f"rosidl_typesupport_c__get_message_type_support_handle__{_TYPE}"]
    handle.restype = ctypes.c_void_p
    return ctypes.c_void_p(handle())


def _qos(depth: int) -> Qos:
    return Qos(
        history=HistoryPolicy.KEEP_LAST.value,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE.value,
        durability=DurabilityPolicy.TRANSIENT_LOCAL.value,
        avoid_ros_namespace_conventions=True,
    )


# Through rmw, because rcl allows no topic name without a leading slash.
def _create(node: Node, name: str, qos: Qos, options: ctypes.Structure) -> ctypes.c_void_p:
    with node.handle:
        made = function(name, ctypes.c_void_p)(
            _rmw_node(node),
            _type_support(),
            ctypes.c_char_p(TOPIC.encode()),
            ctypes.byref(qos),
            ctypes.byref(options),
        )
    if not made:
        raise RclCallFailed(f"{name} failed: {rcutils.take_error_text()}")
    return ctypes.c_void_p(made)


def _destroy(node: Node, name: str, made: ctypes.c_void_p) -> None:
    with node.handle:
        checked(name, _rmw_node(node), made)


def _rmw_node(node: Node) -> ctypes.c_void_p:
    handle = function("rcl_node_get_rmw_handle", ctypes.c_void_p)
    return ctypes.c_void_p(handle(ctypes.c_void_p(node.handle.pointer)))


_POLL_S: Final = 0.005
_ACKNOWLEDGED_POLL_S: Final = 0.001

REPEAT_S: Final = 0.02
"""The time between two announcements of `make_known`, which are acknowledged after about 8 ms."""


class FoundEndpoint(NamedTuple):
    """A discovered endpoint, of this process or of another."""

    gid: bytes
    introduces: bool
    """Whether the endpoint is on `ros_discovery_info`. Then it need not belong to a node."""

    @property
    def process(self) -> bytes:
        """The part of the gid that all endpoints of a process share."""
        return self.gid[:PROCESS_BYTES]


class Discovery:
    """Finds out when a node has discovered the endpoints of all other processes.

    Call `close` before the node is destroyed.
    """

    def __init__(self, node: Node, domain_id: int) -> None:
        self._node = node
        self._domain_id = domain_id
        self._introductions = IntroductionReader(node)
        self._process = gid_of(next(node.publishers))[:PROCESS_BYTES]
        self._others: frozenset[FoundEndpoint] = frozenset()
        self._since_s = time.monotonic()

    def close(self) -> None:
        """Remove the reader of `ros_discovery_info` from the graph."""
        self._introductions.close()

    def wait(self, quiet_s: float, until_s: float, stopped: threading.Event) -> None:
        """Wait until all processes are discovered and nothing changed for `quiet_s` seconds.

        The wait ends at `until_s` (`time.monotonic`) at the latest, or when `stopped` is set.
        Processes on other machines cannot be counted: if there may be any, the wait lasts until
        `until_s`.
        """
        while time.monotonic() < until_s and not stopped.is_set():
            if self.is_complete(quiet_s):
                return
            stopped.wait(_POLL_S)

    def is_alone(self) -> bool:
        """Return True if no other process can be in the domain, on this or another machine."""
        return is_on_this_machine_only() and participants_here(self._domain_id) == 1

    def is_complete(self, quiet_s: float) -> bool:
        """Return whether all processes are discovered and nothing changed for `quiet_s` seconds.

        Always False if other machines may take part.
        """
        # Counted by ports: Fast DDS repeats a lost announcement only after 3 s.
        if not is_on_this_machine_only():
            return False
        self._introductions.look()
        introduced, here = self._introductions.by_process, participants_here(self._domain_id)
        if here is None or len(introduced) < here:
            return False  # before all endpoints are read, which takes 30 us for each
        known = frozenset(_discovered(self._node))
        others = frozenset(each for each in known if each.process != self._process)
        now_s = time.monotonic()
        if others != self._others:
            self._others, self._since_s = others, now_s
        return now_s - self._since_s >= quiet_s and count_complete(known, introduced) >= here

    def make_known(self, until_s: float, stopped: threading.Event) -> bool:
        """Wait until all discovered processes know all publishers of this process.

        Return False if the time `until_s` (`time.monotonic`) comes first, or `stopped` is set.
        """
        writer = IntroductionWriter(self._node)
        try:
            repeat_s = 0.0
            while (now_s := time.monotonic()) < until_s and not stopped.is_set():
                self._introductions.look()
                ours = self._introductions.by_process.get(self._process)
                if ours is not None and now_s >= repeat_s:
                    writer.write(ours.data)
                    repeat_s = now_s + REPEAT_S
                if repeat_s and writer.is_acknowledged():
                    return True
                stopped.wait(_ACKNOWLEDGED_POLL_S)
            return False
        finally:
            writer.close()


def _discovered(node: Node) -> Iterator[FoundEndpoint]:
    for topic in endpoints.topics(node, dds_names=True):
        for find in (endpoints.publishers, endpoints.subscriptions):
            for each in find(node, topic, dds_names=True):
                yield FoundEndpoint(each.gid, topic == TOPIC)


def count_complete(known: Iterable[FoundEndpoint], introduced: Mapping[bytes, Introduction]) -> int:
    """Return how many processes in `introduced` have all their announced endpoints in `known`.

    A process does not count if `known` also has an endpoint of its nodes that is not announced.
    """
    of_nodes: dict[bytes, set[bytes]] = {}
    all_gids: dict[bytes, set[bytes]] = {}
    for each in known:
        all_gids.setdefault(each.process, set()).add(each.gid)
        if not each.introduces:
            of_nodes.setdefault(each.process, set()).add(each.gid)
    return sum(
        of_nodes.get(process, set()) <= introduction.endpoints <= all_gids.get(process, set())
        for process, introduction in introduced.items()
    )


class GraphChanges:
    """Watches for changes of the graph during the `with` block, for one task of the loop."""

    def __init__(self, node: Node) -> None:
        """Watch the graph that `node` sees."""
        self._node = node
        self._changed = asyncio.Event()
        self._awaited = threading.Event()
        self._ended = False

    def __enter__(self) -> Self:
        """Begin to watch.

        Raises:
            RuntimeError: No thread can be started.
        """
        self._loop = asyncio.get_running_loop()
        self._end = GuardCondition(None, None, context=self._node.context)
        self._thread = threading.Thread(target=self._run, name="graph changes", daemon=True)
        try:
            self._thread.start()
        except RuntimeError:
            self._end.destroy()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._ended = True
        self._end.trigger()
        self._awaited.set()
        self._thread.join()
        self._end.destroy()

    async def wait(self, at_most_s: float) -> bool:
        """Wait at most `at_most_s` seconds for a change, and return whether there was one.

        A change since the last `wait` ends the wait at once. One change may be reported twice.
        """
        self._awaited.set()
        with suppress(TimeoutError):
            async with asyncio.timeout(at_most_s):
                await self._changed.wait()
        changed = self._changed.is_set()
        self._changed.clear()
        return changed

    # In the thread

    # A thread, because rcl has no callback for changes. Its pauses keep constant changes cheap.
    def _run(self) -> None:
        context, node = self._node.context.handle, self._node.handle
        assert context is not None
        with context, node:
            wait_set = _rclpy.WaitSet(0, 2, 0, 0, 0, 0, context)
            of_node = function("rcl_node_get_graph_guard_condition", ctypes.c_void_p)
            of_graph = ctypes.c_void_p(of_node(ctypes.c_void_p(node.pointer)))
            add = function("rcl_wait_set_add_guard_condition")
            while not self._ended:
                wait_set.clear_entities()
                wait_set.add_guard_condition(self._end.handle)
                add(ctypes.c_void_p(wait_set.pointer), of_graph, None)
                wait_set.wait(-1)
                with suppress(RuntimeError):  # the loop is closed: no task waits
                    self._loop.call_soon_threadsafe(self._changed.set)
                self._awaited.wait()
                self._awaited.clear()
