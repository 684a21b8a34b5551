"""A subscriber in a separate process, which reports when it received each message."""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

DEADLINE_S = 120.0


def listen(topics: list[list[str]], *, urgent: bool) -> None:
    """Subscribe to `topics`; for each line of stdin, print what was received since, as JSON.

    A message is given by the index of its topic, and the time of receipt [ns]. If `urgent`, the
    threads of the middleware run under SCHED_FIFO where permitted.
    """
    if urgent:
        with suppress(PermissionError):  # the threads of the middleware inherit it
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    from rclpy.context import Context
    from rclpy.node import Node

    from robotctl.ros import AsyncioExecutor, RawTap
    from robotctl.ros.message_types import message_class
    from robotctl.ros.playback import replay_qos

    heard: list[tuple[int, int]] = []

    async def run() -> None:
        context = Context()
        context.init(args=[])
        node = Node("listener", context=context)
        async with AsyncioExecutor(context) as executor:
            executor.add_node(node)
            for number, (name, type_name, offered) in enumerate(topics):

                def take(data: bytes, received_ns: int, *_: object, number: int = number) -> None:
                    heard.append((number, received_ns))

                qos = replay_qos(offered)
                qos.depth = 100_000
                # rclpy's own types know a callback of one argument only.
                tap: Any = RawTap(take)
                node.create_subscription(message_class(type_name), name, tap, qos, raw=True)
            if urgent:  # Not this thread, which would take a core from those.
                os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
            print("ready", flush=True)
            while await asyncio.to_thread(sys.stdin.readline):
                print(json.dumps(heard), flush=True)
                heard.clear()
        node.destroy_node()
        context.try_shutdown()

    asyncio.run(run())


class Listener:
    """The other end of a process that runs `listen`."""

    def __init__(self, topics: list[list[str]], *, urgent: bool) -> None:
        urgency = ["--urgent"] * urgent
        self._process = subject("--listen", json.dumps(topics), *urgency, stdin=subprocess.PIPE)
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == "ready\n"

    def heard(self, expected: int, patience_s: float = 3.0) -> list[list[int]]:
        """Return what was received since the last call: indexes of topics and times [ns].

        Wait until there are `expected` messages, at most `patience_s`.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        found: list[list[int]] = []
        until = time.monotonic() + patience_s
        while len(found) < expected and time.monotonic() < until:
            self._process.stdin.write("\n")
            self._process.stdin.flush()
            found += json.loads(self._process.stdout.readline())
            time.sleep(0.05)
        return found

    def close(self) -> None:
        """End the process."""
        self._process.communicate(timeout=DEADLINE_S)


@contextmanager
def listening(topics: list[list[str]], *, urgent: bool = False) -> Iterator[Listener]:
    """Run a listener during the block."""
    listener = Listener(topics, urgent=urgent)
    try:
        yield listener
    finally:
        listener.close()


def subject(*arguments: str, stdin: int = subprocess.DEVNULL) -> subprocess.Popen[str]:
    """Start the benchmark's script with these arguments in another process."""
    command = [sys.executable, sys.argv[0], *arguments]
    return subprocess.Popen(command, stdin=stdin, stdout=subprocess.PIPE, text=True)
