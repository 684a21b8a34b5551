"""The load: a process that publishes serialized messages, in C++ where there is a compiler."""

from __future__ import annotations

import ctypes
import json
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

SOURCE = Path(__file__).with_suffix(".cpp")
LIBRARIES = (
    "rcl",
    "rcutils",
    "rmw",
    "geometry_msgs__rosidl_typesupport_c",
    "nav_msgs__rosidl_typesupport_c",
    "sensor_msgs__rosidl_typesupport_c",
)
DEPTH = 1000


def build(folder: Path) -> str:
    """Compile the publisher into `folder`; return the path of the library, "" if impossible."""
    compiler = shutil.which("c++")
    prefix = Path(sys.prefix)
    if compiler is None or not (prefix / "include" / "rcl").is_dir():
        return ""
    library = folder / "publisher.so"
    command = [compiler, "-O2", "-std=c++17", "-shared", "-fPIC", str(SOURCE), "-o", str(library)]
    command += [f"-I{package}" for package in (prefix / "include").iterdir()]
    command += [f"-L{prefix / 'lib'}", "-Wl,--allow-shlib-undefined"]
    command += [f"-l{name}" for name in LIBRARIES]
    subprocess.run(command, check=True)
    return str(library)


def publish_compiled(library: str, topic: str, type_name: str, size: int, rate: float) -> None:
    """Publish at `rate` until stdin closes, in C++."""
    publish = ctypes.CDLL(library).publish
    publish.argtypes = [ctypes.c_char_p, ctypes.c_char_p, ctypes.c_size_t, ctypes.c_double]
    publish.restype = None
    publish(topic.encode(), type_name.encode(), size, rate)


def publish_in_python(topic: str, type_name: str, size: int, rate: float) -> None:
    """Publish at `rate` until stdin closes, in rclpy, which reaches about half the rate of C++."""
    import rclpy
    from geometry_msgs.msg import Twist
    from nav_msgs.msg import Odometry
    from sensor_msgs.msg import Image

    kinds = {"twist": Twist, "odometry": Odometry, "image": Image}
    rclpy.init(args=[])
    node = rclpy.create_node("load")
    publisher = node.create_publisher(kinds[type_name], topic, DEPTH)
    message = b"\0\1\0\0" + bytes(size - 4)
    stop = threading.Event()

    def wait_for_the_end() -> None:
        sys.stdin.read()
        stop.set()

    threading.Thread(target=wait_for_the_end, daemon=True).start()
    while not publisher.get_subscription_count() and not stop.is_set():
        time.sleep(0.01)
    sent, begun = 0, time.monotonic()
    while not stop.is_set():
        due = (time.monotonic() - begun) * rate
        while sent < due and not stop.is_set():
            publisher.publish(message)
            sent += 1
        time.sleep(0.0002)
    print(json.dumps({"sent": sent, "per_second": sent / (time.monotonic() - begun)}), flush=True)
    node.destroy_node()
    rclpy.shutdown()


def main() -> None:
    """Run with the arguments LIBRARY ("" for rclpy), TOPIC, TYPE, BYTES, RATE."""
    library, topic, type_name, size, rate = sys.argv[1:]
    if library:
        publish_compiled(library, topic, type_name, int(size), float(rate))
    else:
        publish_in_python(topic, type_name, int(size), float(rate))


if __name__ == "__main__":
    main()
