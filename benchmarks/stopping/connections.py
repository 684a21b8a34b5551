"""A process that keeps idle connections to the control socket, and opens those anew that end.

Ends when its stdin is closed, and prints how many it had at the median of its looks.
"""

from __future__ import annotations

import json
import resource
import select
import socket
import statistics
import sys
import time

LOOK_S = 0.05


def keep(path: str, count: int) -> dict[str, float]:
    """Keep up to `count` until stdin is closed."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    held: list[socket.socket] = []
    looks: list[int] = []
    ready = False
    while not select.select([sys.stdin], [], [], LOOK_S)[0]:
        held = [each for each in held if not _ended(each)]
        while len(held) < count and (opened := _open(path)) is not None:
            held.append(opened)
        looks.append(len(held))
        if not ready and (len(held) == count or looks[-20:].count(len(held)) == 20):
            print("ready", flush=True)
            ready = True
            looks.clear()
    return {"connections": statistics.median(looks or [0])}


def _open(path: str) -> socket.socket | None:
    """A connection, None where the daemon's backlog is full."""
    opened = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
    try:
        opened.connect(path)
    except (BlockingIOError, ConnectionError):
        opened.close()
        time.sleep(0.001)
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
