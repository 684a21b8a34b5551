"""Which folders are trusted: those that no other user can change. Standard library only.

Another user may create a folder of a well-known name first, especially in /tmp, and then put
anything in it, for example a socket that answers `estop` with success.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from robotctl.base.errors import UsageError

ROOT_UID: Final = 0

SYSTEM_RUNTIME: Final = Path("/run")
"""Where root alone makes folders: the unit of a robot gets `robotctl-ROBOT` there."""

UNIT_PREFIX: Final = "robotctl-"

PRIVATE_MODE: Final = 0o700

SHARED_MODE: Final = 0o750
"""The mode of a folder with sockets that a group may use; the group can replace nothing in it."""

OVERFLOW_UID: Final = 65534
"""The uid of every user that a container does not know (user_namespaces(7))."""


class FolderChain:
    """The folders from `base`, the value of `variable` if it is set, down to `folder`.

    Folders above `base` are not checked: they belong to the system, or the user chose them.
    """

    def __init__(
        self,
        base: Path,
        folder: Path,
        variable: str,
        guest: int | None = None,
        *,
        may_be_shared: bool = False,
    ) -> None:
        self.base = base
        self.folder = folder
        self.variable = variable
        self.may_be_shared = may_be_shared
        self._trusted = (ROOT_UID, os.getuid(), guest)

    def for_client(self) -> FolderChain:
        """Return the chain for a client, which may also use these folders of another user.

        Root may use each: `sudo -E robotctl estop` stops the robot of the user who runs it.
        Everyone may use the folder that root has made for a unit of the machine.
        """
        if not os.environ.get(self.variable):
            return self
        try:
            if os.getuid() != ROOT_UID and not self._is_of_a_unit():
                return self
            guest = self.base.stat().st_uid
        except OSError:  # there is no daemon either
            return self
        return FolderChain(self.base, self.folder, self.variable, guest)

    def trusts(self, uid: int) -> bool:
        """Return whether a user is trusted: this user, root and the owner of a client's folder."""
        return uid in self._trusted

    def check(self) -> None:
        """Check the folders that exist.

        Only `base` may be a symbolic link, and only if the owner of the link is trusted.

        Raises:
            UsageError: Another user could change one of the folders.
        """
        for path in self._folders():
            self._check(path)

    def make(self) -> None:
        """Create missing folders for this user alone, and make `folder` private.

        With `may_be_shared`, a folder that another robot of this user shares with a group stays so.

        Raises:
            UsageError: Another user could change one of the folders, `folder` belongs to another
                user, or a folder cannot be created.
        """
        missing = [path for path in self.base.parents if not path.exists()]
        for path in (*reversed(missing), *self._folders()):
            if not os.path.lexists(path):
                try:
                    path.mkdir(mode=PRIVATE_MODE, exist_ok=True)
                except OSError as error:
                    raise self._error(path, f"cannot be created: {error.strerror}") from error
            if path.is_relative_to(self.base):
                self._check(path)
        found = self.folder.stat()
        if found.st_uid != os.getuid():
            raise self._error(self.folder, f"belongs to {user_text(found.st_uid)}")
        kept = (PRIVATE_MODE, SHARED_MODE) if self.may_be_shared else (PRIVATE_MODE,)
        if stat.S_IMODE(found.st_mode) not in kept:
            self.folder.chmod(PRIVATE_MODE)

    def group_writable(self) -> list[str]:
        """Return a warning for each folder that a group can change.

        The private group of a user, whose gid equals the uid, is ignored.
        """
        return [
            f"{path} can be written by group {found.st_gid}, whose members could replace this "
            f"daemon's files (to prevent it: chmod g-w {path})"
            for path in self._folders()
            if path.exists()
            and (found := path.stat()).st_mode & stat.S_IWGRP
            and not found.st_mode & stat.S_ISVTX
            and not found.st_gid == found.st_uid == os.getuid()
        ]

    def _is_of_a_unit(self) -> bool:
        """Return whether only root can have made `base`, for the user to whom it belongs."""
        if self.base.parent != SYSTEM_RUNTIME or not self.base.name.startswith(UNIT_PREFIX):
            return False
        above = SYSTEM_RUNTIME.stat()
        return above.st_uid == ROOT_UID and not above.st_mode & (stat.S_IWGRP | stat.S_IWOTH)

    def _folders(self) -> Iterator[Path]:
        path = self.base
        yield path
        for name in self.folder.relative_to(self.base).parts:
            path /= name
            yield path

    def _check(self, path: Path) -> None:
        try:
            found = path.lstat()
            if stat.S_ISLNK(found.st_mode):
                if path != self.base or not self.trusts(found.st_uid):
                    raise self._error(path, f"is a link of {user_text(found.st_uid)}")
                found = path.stat()
        except (FileNotFoundError, NotADirectoryError):
            return
        if not stat.S_ISDIR(found.st_mode):
            raise self._error(path, "is not a folder")
        if not self.trusts(found.st_uid):
            raise self._error(path, f"belongs to {user_text(found.st_uid)}")
        if found.st_mode & stat.S_IWOTH and not found.st_mode & stat.S_ISVTX:
            ours = found.st_uid == os.getuid()
            cure = f"chmod o-w {path}" if ours else ""
            raise self._error(path, "can be written by every user", cure)

    def _error(self, path: Path, flaw: str, cure: str = "") -> UsageError:
        return UsageError(f"{path} {flaw}", cure or f"set {self.variable} to a folder of yours")


def user_text(uid: int) -> str:
    """Return how a message names the user with this uid."""
    if uid == OVERFLOW_UID:
        return f"uid {uid} (nobody, or a user that this container does not know)"
    return f"uid {uid}"
