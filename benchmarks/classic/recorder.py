"""The classic recorder, in place of rosbag2: every topic, raw, by the mcap package's own writer."""

import sys
import time
from collections.abc import Sequence
from functools import partial
from importlib import import_module
from typing import Any

import rclpy
from mcap.writer import CompressionType, Writer
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy


def get_message(type_name: str) -> Any:
    package, kind, name = type_name.split("/")
    return getattr(import_module(f"{package}.{kind}"), name)


class Recorder(Node):
    def __init__(self, writer: Writer) -> None:
        super().__init__("recorder")
        self.writer = writer
        self.topics: set[str] = set()
        self.create_timer(0.5, self.discover)

    def discover(self) -> None:
        for topic, types in self.get_topic_names_and_types():
            publishers = self.get_publishers_info_by_topic(topic)
            if topic not in self.topics and publishers:
                self.topics.add(topic)
                self.subscribe(topic, types[0], [info.qos_profile for info in publishers])

    def subscribe(self, topic: str, type_name: str, offered: Sequence[QoSProfile]) -> None:
        """Subscribe with a QoS that matches every publisher's offer, as rosbag2 does."""
        reliable = all(each.reliability == ReliabilityPolicy.RELIABLE for each in offered)
        latched = all(each.durability == DurabilityPolicy.TRANSIENT_LOCAL for each in offered)
        qos = QoSProfile(
            depth=100,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )
        schema = self.writer.register_schema(type_name, "ros2msg", b"")
        channel = self.writer.register_channel(topic, "cdr", schema)
        write = partial(self.write, channel)
        self.create_subscription(get_message(type_name), topic, write, qos, raw=True)

    def write(self, channel: int, data: bytes) -> None:
        now = time.time_ns()
        self.writer.add_message(channel, log_time=now, data=data, publish_time=now)


def main() -> None:
    rclpy.init()
    # Without compression, as rosbag2 writes MCAP unless told otherwise.
    writer = Writer(sys.argv[1], compression=CompressionType.NONE)
    writer.start(profile="ros2")
    try:
        rclpy.spin(Recorder(writer))
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        writer.finish()


if __name__ == "__main__":
    main()
