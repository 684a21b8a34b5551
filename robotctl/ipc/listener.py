"""The listening socket: a file for its owner or a group, created again if it is removed."""

from __future__ import annotations

import asyncio
import errno
import logging
import os
import socket
import stat
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from robotctl.errors import AlreadyRunning, RobotctlError, UsageError
from robotctl.ipc.peer import peer_of
from robotctl.ipc.readiness import until_readable
from robotctl.ipc.socket_group import SocketGroup, open_folder, open_socket
from robotctl.paths import chain_to, make_private

_log = logging.getLogger(__name__)

BACKLOG = 1024
"""Clients that may wait to be accepted: the largest burst that the daemon promises to take.

With a full backlog, asyncio's connect returns a socket that is not connected."""

LOOK_S = 1.0
"""Period of the check that the socket file is still the listener's own."""

_OUT_OF_RESOURCES = {errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM}
_RETRY_ACCEPT_S = 0.1


class Listener:
    """A listening socket at `path`; `close` removes the file if it is still the listener's own."""

    def __init__(self, path: Path, group: SocketGroup | None = None) -> None:
        self._path = path
        self._group = group
        self._id = (0, 0)
        self._sock: socket.socket
        self._spare: int | None = None
        """A descriptor for a client when no other is free, since it may stop the robot."""

    def open(self) -> None:
        """Bind and listen; from now on the connect of a client succeeds.

        Raises:
            UsageError: The folder belongs to another user or is open to another group, or `path`
                is not a socket.
            AlreadyRunning: Another process answers at `path`.
        """
        make_private(self._path.parent)
        remove_stale(self._path)
        open_folder(self._path, self._group)
        self._sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            previous = os.umask(0o177)  # with a chmod after bind, any user could connect before it
            try:
                self._sock.bind(str(self._path))
            except OSError as error:  # the error does not name the path
                raise OSError(error.errno, error.strerror, str(self._path)) from None
            finally:
                os.umask(previous)
            self._id = _id_of(self._path)
            if self._group is not None:
                open_socket(self._path, self._group)
            self._sock.listen(BACKLOG)
            self._sock.setblocking(False)
            self._keep_spare()
        except BaseException:
            self._sock.close()
            raise

    def close(self) -> None:
        """Stop listening, and remove the socket file."""
        self._sock.close()
        self._give_up_spare()
        if self._is_in_place():
            self._path.unlink(missing_ok=True)

    async def accept(self, make_room: Callable[[], bool]) -> socket.socket:
        """Wait for the next client and return its socket.

        Where the process has no free descriptor, one that was kept for this is used. If that is in
        use, `make_room` is called to close a connection. It returns whether it did; otherwise this
        waits until a descriptor is free.
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
        """Wait until clients no longer reach this process at the path.

        A logout may remove the folder, a cleanup job may remove old files, another user may take
        over the folder, or another process the path.
        """
        while self._is_in_place():  # noqa: ASYNC110 - nothing announces it
            await asyncio.sleep(LOOK_S)

    async def reopen(self, on_failure: Callable[[str], None]) -> None:
        """Listen at the path again as soon as possible; pass each new reason to `on_failure`."""
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
        """Close the descriptor that is kept; return whether there was one."""
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
        AlreadyRunning: Another process answers at `path`.
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
            except BlockingIOError:  # it listens, and has many clients
                raise AlreadyRunning(f"{path} is in use") from None
            raise AlreadyRunning(f"pid {peer_of(probe).pid} answers at {path} already")
