"""The Unix group whose members may use a control socket besides its owner and root."""

from __future__ import annotations

import grp
import os
import pwd
import stat
from pathlib import Path
from typing import Final, NamedTuple

from robotctl.errors import UsageError
from robotctl.paths import RUNTIME_VARIABLE
from robotctl.trust import PRIVATE_MODE, ROOT_UID, SHARED_MODE

SOCKET_MODE: Final = 0o660


class SocketGroup(NamedTuple):
    """A group by name and number."""

    name: str
    gid: int


def socket_group(name: str) -> SocketGroup | None:
    """Return the group with this name; None for "".

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
        user = _user_name()
        raise UsageError(
            f"socket.group: user {user!r} is not in group {name!r}",
            f"sudo usermod -aG {name} {user}, then log in again or restart the unit",
        )
    return SocketGroup(name, gid)


def open_folder(path: Path, group: SocketGroup | None) -> None:
    """Open the folder of the socket `path` to the group; for None, to its owner alone.

    Another robot of this user may share the folder: then it stays open to that robot's group.

    Raises:
        UsageError: The folder is open to another group, or its members cannot reach it.
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


def open_socket(path: Path, group: SocketGroup) -> None:
    """Let the members of the group connect to the socket at `path`."""
    os.chown(path, -1, group.gid)
    path.chmod(SOCKET_MODE)


def _check_reachable(base: Path, group: SocketGroup) -> None:
    found = base.stat()
    by_group = found.st_gid == group.gid and found.st_mode & stat.S_IXGRP
    if not by_group and not found.st_mode & stat.S_IXOTH:
        raise UsageError(
            f"socket.group: {base} is closed to group {group.name!r}",
            "start the daemon by a unit: sudo robotctl boot install --system",
        )


def _user_name() -> str:
    try:
        return pwd.getpwuid(os.geteuid()).pw_name
    except KeyError:
        return str(os.geteuid())
