"""The socket at which a daemon listens, for its user or a group."""

from __future__ import annotations

import asyncio
import errno
import grp
import logging
import os
import pwd
import select
import socket
import stat
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final, NamedTuple

from robotctl.base.errors import AlreadyRunning, RobotctlError, UsageError
from robotctl.base.paths import RUNTIME_VARIABLE, chain_to, make_private
from robotctl.base.trust import PRIVATE_MODE, ROOT_UID, SHARED_MODE
from robotctl.ipc.protocol import peer_of

SOCKET_MODE: Final = 0o660


class SocketGroup(NamedTuple):
    """A group by name and number."""

    name: str
    gid: int


def socket_group(name: str) -> SocketGroup | None:
    """Return the group with this name, or None if `name` is "".

    Raises:
        UsageError: There is no such group, or this user is not in it.
    """
    if not name:
        return None
    try:
        gid = grp.getgrnam(name).gr_gid
    except (KeyError, ValueError):  # ValueError: a zero byte
        raise UsageError(
            f"socket.group: there is no group {name!r}", f"make it: sudo groupadd {name}"
        ) from None
    if os.geteuid() != ROOT_UID and gid not in (os.getegid(), *os.getgroups()):
        try:
            user = pwd.getpwuid(os.geteuid()).pw_name
        except KeyError:
            user = str(os.geteuid())
        raise UsageError(
            f"socket.group: user {user!r} is not in group {name!r}",
            f"sudo usermod -aG {name} {user}, then log in again or restart the unit",
        )
    return SocketGroup(name, gid)


def open_folder(path: Path, group: SocketGroup | None) -> None:
    """Open the folder of the socket `path` to `group`, or only to the owner if `group` is None.

    Without `group`, a folder that another robot shares with its group stays shared.

    Raises:
        UsageError: The folder is shared with another group, or `group` cannot reach it.
    """
    folder = path.parent
    others = any(other != path for other in folder.glob("*.sock"))
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        found = os.fstat(descriptor)
        is_shared = others and stat.S_IMODE(found.st_mode) == SHARED_MODE
        if group is None:
            if not is_shared:
                os.fchmod(descriptor, PRIVATE_MODE)
            return
        if is_shared and found.st_gid != group.gid:
            raise UsageError(
                f"{folder} is open to group {found.st_gid}, for another robot",
                f"start this robot with another {RUNTIME_VARIABLE}",
            )
        _check_reachable(folder.parent, group)
        os.fchown(descriptor, -1, group.gid)
        os.fchmod(descriptor, SHARED_MODE)
    finally:
        os.close(descriptor)


def _check_reachable(base: Path, group: SocketGroup) -> None:
    found = base.stat()
    by_group = found.st_gid == group.gid and found.st_mode & stat.S_IXGRP
    if not by_group and not found.st_mode & stat.S_IXOTH:
        raise UsageError(
            f"socket.group: {base} is closed to group {group.name!r}",
            "start the daemon by a unit: sudo robotctl boot install --system",
        )


async def until_readable(sock: socket.socket) -> None:
    """Wait until `sock` has data to read, or a connection to accept."""
    # Not `loop.sock_recv` or `loop.sock_accept`, which may lose data when the task is cancelled.
    loop = asyncio.get_running_loop()
    readable = loop.create_future()
    loop.add_reader(sock, _wake, readable)
    try:
        await readable
    finally:
        loop.remove_reader(sock)


def has_event(sock: socket.socket, events: int) -> bool:
    """Return whether `select.poll` reports one of `events`, or the connection is closed.

    If `events` is 0, return whether the connection is closed in both directions.
    """
    poll = select.poll()
    poll.register(sock, events)
    return bool(poll.poll(0))


def _wake(waiting: asyncio.Future[None]) -> None:
    if not waiting.done():
        waiting.set_result(None)


_log = logging.getLogger(__name__)

# A burst of this size must not fail. With a full backlog, asyncio's connect returns a socket that
# is not connected.
BACKLOG = 1024
"""The number of clients that may wait to be accepted."""

LOOK_S = 1.0
"""The time between two checks that the socket file was not removed or replaced."""

_OUT_OF_RESOURCES = {errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM}
_RETRY_ACCEPT_S = 0.1


class Listener:
    """A socket that listens at `path`, and accepts clients even if no descriptor is free."""

    def __init__(self, path: Path, group: SocketGroup | None = None) -> None:
        self._path = path
        self._group = group
        self._id = (0, 0)
        self._sock: socket.socket
        self._spare: int | None = None
        """A reserved descriptor, closed to accept a client when no other is free."""

    def open(self) -> None:
        """Bind and listen. From now on clients can connect.

        Raises:
            UsageError: Another user owns the folder, the group cannot use it, or `path` is a file.
            AlreadyRunning: Another process listens at `path`.
            OSError: The socket file cannot be created.
        """
        make_private(self._path.parent)
        remove_stale(self._path)
        open_folder(self._path, self._group)
        self._sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            previous = os.umask(0o177)  # with a chmod after bind, any user could connect before it
            try:
                self._sock.bind(str(self._path))
            except OSError as error:  # this error lacks the path
                raise OSError(error.errno, error.strerror, str(self._path)) from None
            finally:
                os.umask(previous)
            self._id = _id_of(self._path)
            if self._group is not None:
                os.chown(self._path, -1, self._group.gid)
                self._path.chmod(SOCKET_MODE)
            self._sock.listen(BACKLOG)
            self._sock.setblocking(False)
            self._keep_spare()
        except BaseException:
            self._sock.close()
            raise

    def close(self) -> None:
        """Stop listening, and remove the socket file unless it was replaced."""
        self._sock.close()
        self._give_up_spare()
        if self._is_in_place():
            self._path.unlink(missing_ok=True)

    async def accept(self, make_room: Callable[[], bool]) -> socket.socket:
        """Wait for the next client and return its socket.

        If no descriptor is free, the reserved one is closed. If that is gone, too, `make_room` is
        called: it closes a connection if it can, and returns whether it did.
        """
        self._keep_spare()
        while True:
            try:
                client = self._sock.accept()[0]
                client.setblocking(False)
                return client
            except BlockingIOError:
                await until_readable(self._sock)
            except OSError as error:
                if error.errno in _OUT_OF_RESOURCES:
                    _log.warning("no connection can be accepted: %s", error)
                    has_room = self._give_up_spare() or make_room()
                    await asyncio.sleep(0.0 if has_room else _RETRY_ACCEPT_S)
                elif error.errno != errno.ECONNABORTED:
                    raise

    async def lost(self) -> None:
        """Wait until clients can no longer reach this process at the path."""
        while self._is_in_place():  # noqa: ASYNC110 - nothing announces it
            await asyncio.sleep(LOOK_S)

    async def reopen(self, on_failure: Callable[[str], None]) -> None:
        """Retry `open` until it succeeds. Call `on_failure` for each new reason of a failure."""
        self._sock.close()
        said = ""
        while True:
            try:
                return self.open()
            except (OSError, RobotctlError) as error:
                if str(error) != said:
                    said = str(error)
                    _log.error("no client can reach this daemon: %s", said)
                    on_failure(f"no client can reach this daemon: {said}")
            await asyncio.sleep(LOOK_S)

    def _keep_spare(self) -> None:
        if self._spare is None:
            with suppress(OSError):
                self._spare = os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC)

    def _give_up_spare(self) -> bool:
        """Close the reserved descriptor, and return whether there was one."""
        if self._spare is None:
            return False
        os.close(self._spare)
        self._spare = None
        return True

    def _is_in_place(self) -> bool:
        with suppress(OSError, UsageError):
            chain_to(self._path.parent).check()
            return _id_of(self._path) == self._id
        return False


def _id_of(path: Path) -> tuple[int, int]:
    found = path.lstat()
    return found.st_dev, found.st_ino


def remove_stale(path: Path) -> None:
    """Remove the socket file that a dead daemon has left at `path`.

    Raises:
        UsageError: `path` is not a socket.
        AlreadyRunning: Another process listens at `path`.
    """
    with suppress(FileNotFoundError):
        if not stat.S_ISSOCK(path.lstat().st_mode):
            raise UsageError(f"{path} is not a socket: remove it, then start again")
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            probe.setblocking(False)
            try:
                probe.connect(str(path))
            except ConnectionRefusedError:
                return path.unlink()
            except BlockingIOError:  # a process listens, and its backlog is full
                raise AlreadyRunning(f"{path} is in use") from None
            raise AlreadyRunning(f"pid {peer_of(probe).pid} answers at {path} already")
