"""A peer that creates publishers without rcl, so that their names can be any bytes."""

from __future__ import annotations

import ctypes
import os
import struct
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.type_support import check_for_type_support
from std_msgs.msg import String

from robotctl.ros.executor.rcutils import SerializedMessage
from robotctl.ros.graph import endpoints
from robotctl.ros.graph.rcl_graph import Qos
from robotctl.ros.message_types import message_class
from tests.support.lines import obey

_CALLBACKS_BYTES = 96
"""At least the size of message_type_support_callbacks_t."""

_FASTRTPS = b"rosidl_typesupport_fastrtps_c"


class _TypeSupport(ctypes.Structure):
    """rosidl_message_type_support_t"""

    _fields_ = tuple(
        (name, ctypes.c_void_p)
        for name in ("identifier", "data", "func", "get_hash", "get_description", "get_sources")
    )


class _Options(ctypes.Structure):
    """rmw_publisher_options_t"""

    _fields_ = (("payload", ctypes.c_void_p), ("require_unique_flow", ctypes.c_int))


_FIND = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_char_p)


class Hostile:
    def __init__(self) -> None:
        self.node = Node(f"hostile_{os.getpid()}")  # the graph lists an ended node for a while
        self._rmw = ctypes.CDLL("librmw_fastrtps_cpp.so")
        self._kept: list[Any] = []
        self._introducer = 0

    def offer(self, topic: str, type_name: str = "std_msgs/msg/String") -> None:
        """Create a publisher; names are in Latin-1, one character per byte."""
        support = self._support(String, type_name.encode("latin-1"))
        self._create(f"rt{topic}", support, latched=False)

    def rename(self, name: str, namespace: str) -> None:
        """Announce that our publishers belong to a node with this name and namespace (Latin-1)."""
        info = message_class("rmw_dds_common/msg/ParticipantEntitiesInfo")
        if not self._introducer:
            support = self._support(info, b"")
            self._introducer = self._create("ros_discovery_info", support, latched=True)
        mine = [
            each.gid
            for topic in endpoints.topics(self.node)
            for each in endpoints.publishers(self.node, topic)
            if each.node_name == self.node.get_name()
        ]
        participant = mine[0][:12] + bytes.fromhex("000001c1")
        body = participant + struct.pack("<I", 1)
        for text in (namespace.encode("latin-1"), name.encode("latin-1")):
            body += bytes(-len(body) % 4) + struct.pack("<I", len(text) + 1) + text + b"\0"
        body += bytes(-len(body) % 4) + struct.pack("<II", 0, len(mine)) + b"".join(mine)
        data = ctypes.create_string_buffer(b"\0\1\0\0" + body, len(body) + 4)
        message = SerializedMessage(ctypes.addressof(data), len(data), len(data))
        code = self._rmw.rmw_publish_serialized_message(
            ctypes.c_void_p(self._introducer), ctypes.byref(message), None
        )
        assert code == 0

    def _support(self, kind: Any, type_name: bytes) -> int:
        """Return the address of `kind`'s type support; `type_name` renames the type for DDS."""
        check_for_type_support(kind)
        real = _TypeSupport.from_address(_pointer(kind._TYPE_SUPPORT))
        find = _FIND(real.func)
        made = _TypeSupport.from_buffer_copy(
            ctypes.string_at(find(ctypes.addressof(real), _FASTRTPS), ctypes.sizeof(_TypeSupport))
        )
        if type_name:
            namespace, _, short = type_name.rpartition(b"/")
            names = [
                ctypes.create_string_buffer(text)
                for text in (namespace.replace(b"/", b"::"), short)
            ]
            callbacks = ctypes.create_string_buffer(
                ctypes.string_at(made.data, _CALLBACKS_BYTES), _CALLBACKS_BYTES
            )
            struct.pack_into("PP", callbacks, 0, *map(ctypes.addressof, names))
            made.data = ctypes.addressof(callbacks)
            self._kept += [*names, callbacks]

        def dispatch(_: int, identifier: bytes) -> int:
            fake = identifier == _FASTRTPS
            return ctypes.addressof(made) if fake else find(ctypes.addressof(real), identifier)

        function = _FIND(dispatch)
        outer = _TypeSupport.from_buffer_copy(real)
        outer.func = ctypes.cast(function, ctypes.c_void_p).value
        self._kept += [made, function, outer]
        return ctypes.addressof(outer)

    def _create(self, dds_topic: str, support: int, *, latched: bool) -> int:
        profile = Qos(history=1, depth=10, reliability=1, durability=1 if latched else 2)
        profile.avoid_ros_namespace_conventions = True
        rcl = ctypes.CDLL("librcl.so")
        rcl.rcl_node_get_rmw_handle.restype = ctypes.c_void_p
        create = self._rmw.rmw_create_publisher
        create.restype = ctypes.c_void_p
        with self.node.handle:
            publisher = create(
                ctypes.c_void_p(
                    rcl.rcl_node_get_rmw_handle(ctypes.c_void_p(self.node.handle.pointer))
                ),
                ctypes.c_void_p(support),
                ctypes.c_char_p(dds_topic.encode("latin-1")),
                ctypes.byref(profile),
                ctypes.byref(_Options()),
            )
        assert publisher, f"no publisher of {dds_topic!r}"
        return int(publisher)


def _pointer(capsule: Any) -> int:
    api = ctypes.pythonapi
    api.PyCapsule_GetName.restype = ctypes.c_char_p
    api.PyCapsule_GetName.argtypes = [ctypes.py_object]
    api.PyCapsule_GetPointer.restype = ctypes.c_void_p
    api.PyCapsule_GetPointer.argtypes = [ctypes.py_object, ctypes.c_char_p]
    return int(api.PyCapsule_GetPointer(capsule, api.PyCapsule_GetName(capsule)))


def main() -> None:
    rclpy.init(args=[])
    hostile = Hostile()
    obey(hostile)
    # rcl does not know these publishers: they end with the process.
    hostile.node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
