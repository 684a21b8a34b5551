"""How soon the robot is told to stop when nobody holds it any more, as another process hears it.

    python benchmarks/teleop.py [-n 20]

`robotctl teleop` runs on a terminal of its own, beside a daemon with the simulated robot, and a key
or the button of a gamepad is held until the robot is fast. Then one thing happens:

released         the terminal tells the release of the key; until the first smaller command
repeats end      a terminal without releases sends the key a last time; until the first exact zero
closed           the terminal closes; until the first exact zero
frozen           SIGSTOP; until the first exact zero
killed           SIGKILL; until the first exact zero
cut              its connections to the daemon are closed; until the first exact zero
button released  the gamepad tells the release of its button; until the first smaller command
gamepad gone     the gamepad sends nothing more; until the first exact zero

A gamepad sends each change at once, and its state 50 times a second.

The times end when Fast DDS has received the command in this process.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import socket
import statistics
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))  # tests.support

from geometry_msgs.msg import Twist
from rclpy.node import Node
from sensor_msgs.msg import Joy

from tests.support.spinning import node_in
from tests.support.terminals import Terminal
from tests.support.waiting import until
from tests.support.world import World, new_world

FAST_MPS = 0.25
REPEAT_S = 0.033
JOY_PERIOD_S = 0.02
RELEASES = ("released", "button released")
WAYS = (*RELEASES, "repeats end", "closed", "frozen", "killed", "cut", "gamepad gone")
RELEASE_LIMIT_MS, ZERO_LIMIT_MS = 20.0, 150.0
SOCKET = "robot.sock"
W_DOWN, W_UP = "\x1b[119;1:1u", "\x1b[119;1:3u"


class Listener:
    """The commands, each with the wall-clock time [ns] at which Fast DDS received it."""

    def __init__(self, node: Node) -> None:
        self.heard: list[tuple[int, float]] = []
        take: Any = self._take  # rclpy's own types know a callback of one argument only
        node.create_subscription(Twist, "/cmd_vel", take, 1000)

    def _take(self, command: Any, info: Any) -> None:
        self.heard.append((info["received_timestamp"], command.linear.x))

    def is_fast(self) -> bool:
        return bool(self.heard) and self.heard[-1][1] > FAST_MPS

    def first_zero(self, after_ns: int) -> int | None:
        return next((at_ns for at_ns, speed in self.heard if at_ns > after_ns and not speed), None)

    def first_slower(self, after_ns: int) -> int | None:
        """Return when the first command came that is smaller than the one before it."""
        both = pairwise(self.heard)
        return next((at[0] for last, at in both if at[0] > after_ns and at[1] < last[1]), None)


class Gamepad:
    """A gamepad whose stick points forward."""

    def __init__(self, node: Node) -> None:
        self._publisher = node.create_publisher(Joy, "/joy", 10)
        self._timer = node.create_timer(JOY_PERIOD_S, self._publish)
        self._timer.cancel()
        self._pressed = False

    def press(self, pressed: bool) -> None:
        """Press or release the button, and send the state again and again from now on."""
        self._pressed = pressed
        self._publish()
        self._timer.reset()

    def vanish(self) -> None:
        self._timer.cancel()

    def _publish(self) -> None:
        self._publisher.publish(Joy(axes=[0.0, 1.0], buttons=[0, 0, 0, 0, int(self._pressed)]))


class Relay:
    """A socket that leads to the daemon's until it is cut; a client with `environment` takes it."""

    def __init__(self, world: World, folder: Path) -> None:
        (folder / "robotctl").mkdir(mode=0o700, parents=True)
        self.environment = {**world.environment, "XDG_RUNTIME_DIR": str(folder)}
        self._daemon = str(Path(world.environment["XDG_RUNTIME_DIR"]) / "robotctl" / SOCKET)
        self._sockets = [socket.socket(socket.AF_UNIX)]
        self._sockets[0].bind(str(folder / "robotctl" / SOCKET))
        self._sockets[0].listen()
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self) -> None:
        for each in self._sockets:
            with suppress(OSError):  # it is closed already
                each.shutdown(socket.SHUT_RDWR)

    def _accept(self) -> None:
        with suppress(OSError):  # the relay is cut
            while True:
                near, far = self._sockets[0].accept()[0], socket.socket(socket.AF_UNIX)
                far.connect(self._daemon)
                self._sockets += [near, far]
                for ends in ((near, far), (far, near)):
                    threading.Thread(target=self._forward, args=ends, daemon=True).start()

    def _forward(self, source: socket.socket, target: socket.socket) -> None:
        with suppress(OSError):  # one of the two is gone
            while data := source.recv(65536):
                target.sendall(data)
            target.shutdown(socket.SHUT_RDWR)


def sit(environment: Mapping[str, str], *arguments: str, tells_releases: bool = True) -> Terminal:
    terminal = Terminal("teleop", *arguments, environment=environment)
    terminal.until(r"\x1b\[c")
    terminal.press("\x1b[?0u\x1b[?62c" if tells_releases else "\x1b[?62c")
    terminal.until("q quit")
    return terminal


def hold(listener: Listener, release: Callable[[], object], press: Callable[[], object]) -> None:
    """Press until the robot is fast; press again after a mishap."""

    def is_fast() -> bool:
        if not listener.heard or listener.heard[-1][1] == 0.0:
            release()
            time.sleep(0.05)
            press()
            time.sleep(0.1)
        return listener.is_fast()

    until(is_fast)
    time.sleep(random.uniform(0.02, 0.06))


def measure(world: World, listener: Listener, gamepad: Gamepad, what: str) -> float:
    """Return how many milliseconds it took once."""
    by_gamepad = "button" in what or "gamepad" in what
    with ExitStack() as stack:
        stack.callback(lambda: until(lambda: stands(world)))
        environment: Mapping[str, str] = world.environment
        acts: dict[str, Callable[[], object]] = {}
        if what == "cut":
            folder = Path(stack.enter_context(TemporaryDirectory()))
            relay = Relay(world, folder / "run")
            environment, acts["cut"] = relay.environment, relay.cut
            stack.callback(relay.cut)
        if by_gamepad:
            stack.callback(gamepad.vanish)
            gamepad.press(pressed=False)
            terminal = sit(environment, "--joy", "joy")
        else:
            terminal = sit(environment, tells_releases=what != "repeats end")
        stack.callback(terminal.close)
        acts |= {
            "released": lambda: terminal.press(W_UP),
            "closed": terminal.hang_up,
            "frozen": lambda: os.kill(terminal.pid, signal.SIGSTOP),
            "killed": lambda: os.kill(terminal.pid, signal.SIGKILL),
            "button released": lambda: gamepad.press(pressed=False),
            "gamepad gone": gamepad.vanish,
        }
        if by_gamepad:
            hold(listener, acts["button released"], lambda: gamepad.press(pressed=True))
        elif what in acts:
            hold(listener, acts["released"], lambda: terminal.press(W_DOWN))
        asked_ns = act(acts[what]) if what in acts else repeat(terminal, listener)
        first = listener.first_slower if what in RELEASES else listener.first_zero
        found_ns: Any = until(lambda: first(asked_ns))
        return float(found_ns - asked_ns) / 1e6


def act(do: Callable[[], object]) -> int:
    """Do it, and return when it began."""
    begun_ns = time.time_ns()
    do()
    return begun_ns


def repeat(terminal: Terminal, listener: Listener) -> int:
    """Send a key until the robot is fast, and return when it was sent last."""
    asked_ns = 0
    while not listener.is_fast():
        asked_ns = act(lambda: terminal.press("w"))
        time.sleep(REPEAT_S)
    return asked_ns


def stands(world: World) -> bool:
    status = world.status()
    return status["lease"] is None and status["mode"] == "IDLE"


def main() -> int:
    """Print the table; 1 if a time is above its limit."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-n", type=int, default=20, help="times of each")
    count = parser.parse_args().n
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    missed = 0
    with new_world() as world:
        world.ok("start", "--sim")
        until(lambda: world.status()["pose"] and world.status()["battery"])
        with node_in(world.domain_id, "listener") as node:
            listener, gamepad = Listener(node), Gamepad(node)
            taken: dict[str, list[float]] = {way: [] for way in WAYS}
            for _ in range(count):
                for way, values in taken.items():
                    values.append(measure(world, listener, gamepad, way))
        world.ok("stop")
    print("| what happens | median [ms] | lowest .. highest | wanted | |")
    print("|---|---|---|---|---|")
    for way, values in taken.items():
        limit_ms = RELEASE_LIMIT_MS if way in RELEASES else ZERO_LIMIT_MS
        reached = max(values) <= limit_ms
        missed += not reached
        print(
            f"| {way} | {statistics.median(values):.1f} | {min(values):.1f} .. {max(values):.1f} "
            f"| <= {limit_ms:g} | {'reached' if reached else 'MISSED'} |"
        )
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
