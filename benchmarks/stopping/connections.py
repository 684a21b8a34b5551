"""A process that keeps idle connections to the control socket.

A connection that the daemon closes is opened again about a second later. Ends when its stdin is
closed, and prints the median of the open connections, and how many were opened per second.
"""

from __future__ import annotations

import json
import random
import resource
import select
import socket
import statistics
import sys
import time

LOOK_S = 0.05
REOPEN_S = (0.5, 1.5)
"""The range of the random delay [s]: without it, all would be opened in one burst."""


def keep(path: str, count: int) -> dict[str, float]:
    """Keep up to `count` connections until stdin is closed; return what is to be printed."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    held = [opened for _ in range(count) if (opened := _open(path)) is not None]
    due_s = [0.0] * (count - len(held))
    looks: list[int] = []
    print("ready", flush=True)
    opened_count, begun_s = 0, time.monotonic()
    while not select.select([sys.stdin], [], [], LOOK_S)[0]:
        now_s = time.monotonic()
        living = [each for each in held if not _ended(each)]
        due_s += [now_s + random.uniform(*REOPEN_S) for _ in range(len(held) - len(living))]
        late = [each for each in due_s if each <= now_s]
        new = [opened for _ in late if (opened := _open(path)) is not None]
        due_s = [each for each in due_s if each > now_s] + [now_s] * (len(late) - len(new))
        held = living + new
        opened_count += len(new)
        looks.append(len(held))
    return {
        "connections": statistics.median(looks or [len(held)]),
        "opened": opened_count / (time.monotonic() - begun_s),
    }


def _open(path: str) -> socket.socket | None:
    """Return a new connection, None if the daemon's backlog is full."""
    opened = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
    try:
        opened.connect(path)
    except (BlockingIOError, ConnectionError):
        opened.close()
        return None
    return opened


def _ended(connection: socket.socket) -> bool:
    try:
        while data := connection.recv(4096):
            del data
    except BlockingIOError:
        return False
    except ConnectionError:
        pass
    connection.close()
    return True


if __name__ == "__main__":
    print(json.dumps(keep(sys.argv[1], int(sys.argv[2]))), flush=True)
