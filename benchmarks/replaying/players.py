"""Three players: that of robotctl, and two others with the same publisher.

Each returns the monotonic time [ns] at which it passed each message to the middleware.
"""

from __future__ import annotations

import asyncio
import gc
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from replaying.material import ODOMETRY, QOS, START_NS

from robotctl.recording import read_messages

READ_AHEAD = 1000


def play_with_robotctl(file: Path, domain_id: int) -> list[int]:
    """Play as the process of `robotctl replay` does; its `send` is wrapped to note the time."""
    from robotctl.base.processes import REPORT_OPTION
    from robotctl.replay import __main__ as process
    from robotctl.replay.job import Job
    from robotctl.ros.playback import ReplaySession

    stamps: list[int] = []
    opened = ReplaySession.open

    def noted(self: Any, *arguments: Any, **options: Any) -> Callable[[bytes], bool]:
        send, note, now = opened(self, *arguments, **options), stamps.append, time.monotonic_ns

        def sending(data: bytes) -> bool:
            note(now())
            return send(data)

        return sending

    ReplaySession.open = noted  # type: ignore[method-assign]
    read_fd, write_fd = os.pipe()
    os.write(write_fd, f"{Job(file, domain_id).to_json()}\n".encode())
    os.dup2(read_fd, 0)
    with open(os.devnull, "wb") as progress:
        if code := process.main([REPORT_OPTION, str(progress.fileno())]):
            raise SystemExit(f"the replay ended with exit code {code}")
    return stamps


@contextmanager
def opened(domain_id: int) -> Iterator[Callable[[bytes], bool]]:
    """Yield the `send` function of the publisher that `robotctl replay` uses."""
    from robotctl.ros.context import Membership
    from robotctl.ros.playback import ReplaySession

    with Membership(domain_id, "publisher") as membership:
        ros = ReplaySession(membership)
        ros.settle()
        send = ros.open("/odom", ODOMETRY, QOS, patient=False)
        ros.wait_for_matches()
        gc.freeze()
        yield send
        ros.wait_until_received()


def play_with_asyncio(file: Path, domain_id: int) -> list[int]:
    """Play with an asyncio.sleep until the absolute time of each message."""
    stamps: list[int] = []
    messages = list(read_messages(file))

    async def run(send: Callable[[bytes], bool]) -> None:
        loop = asyncio.get_running_loop()
        start = loop.time() + 0.02
        for message in messages:
            await asyncio.sleep(start + (message.log_ns - START_NS) / 1e9 - loop.time())
            stamps.append(time.monotonic_ns())
            send(message.data)

    with opened(domain_id) as send:
        asyncio.run(run(send))
    return stamps


def play_with_condition(file: Path, domain_id: int) -> list[int]:
    """Play as rosbag2 does: a thread fills a queue; wait on a condition variable per message."""
    stamps: list[int] = []
    queue: deque[Any] = deque()
    room = threading.Condition()
    changed = threading.Condition()

    def read() -> None:
        for message in read_messages(file):
            with room:
                room.wait_for(lambda: len(queue) < READ_AHEAD)
                queue.append(message)

    with opened(domain_id) as send:
        threading.Thread(target=read, daemon=True).start()
        time.sleep(0.2)
        start = time.monotonic() + 0.02
        while queue:
            with room:
                message = queue.popleft()
                room.notify()
            due = start + (message.log_ns - START_NS) / 1e9
            with changed:
                while (left := due - time.monotonic()) > 0:
                    changed.wait(left)
            stamps.append(time.monotonic_ns())
            send(message.data)
    return stamps


PLAYERS = {
    "robotctl": play_with_robotctl,
    "asyncio": play_with_asyncio,
    "condition": play_with_condition,
}
