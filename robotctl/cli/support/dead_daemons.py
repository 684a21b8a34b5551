"""The sockets that killed daemons of this user have left."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from robotctl.cli.support import robots
from robotctl.daemon.lock import is_owned, owned
from robotctl.errors import AlreadyRunning, UsageError
from robotctl.ipc.listener import remove_stale
from robotctl.paths import lock_path, socket_path


def killed() -> list[str]:
    """Return the robots whose socket is there, and whose lock no daemon holds."""
    found = []
    for robot in robots.names():
        with suppress(UsageError):  # the name of no robot
            if not is_owned(lock_path(robot)):
                found.append(robot)
    return found


def remove_sockets() -> list[Path]:
    """Remove those sockets, each while its lock is held, and return them."""
    removed = []
    for robot in killed():
        with suppress(AlreadyRunning, UsageError), owned(lock_path(robot), robot):
            remove_stale(socket_path(robot))
            removed.append(socket_path(robot))
    return removed
