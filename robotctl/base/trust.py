"""Checks that no other user can change a folder. Standard library only."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from robotctl.base.errors import UsageError

ROOT_UID: Final = 0

SYSTEM_RUNTIME: Final = Path("/run")
"""Only root creates folders here, such as `robotctl-ROBOT` for the systemd unit of a robot."""

UNIT_PREFIX: Final = "robotctl-"

PRIVATE_MODE: Final = 0o700

SHARED_MODE: Final = 0o750
"""The mode of a group's socket folder, in which its members can only connect."""

OVERFLOW_UID: Final = 65534
"""The uid that a container shows for each user without a mapping (user_namespaces(7))."""


# Another user may create a folder of a well-known name first, especially in /tmp, with a socket
# that answers `estop` with success.
class FolderChain:
    """The folders from `base`, set by the environment variable `variable`, down to `folder`."""

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
        """Return a chain that also trusts the owner of `base`, the user whose daemon is called.

        Only if `variable` is set. Root trusts any owner, others only the owner of a unit's folder.
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
        """Return whether `uid` is root, this user, or the owner that `for_client` added."""
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
        """Create missing folders with access for this user only, and make `folder` private.

        With `may_be_shared`, a `folder` that already has SHARED_MODE keeps this mode.

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
        """Return a warning for each folder that a group other than the user's own can change."""
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
        """Return whether `base` is a systemd unit's runtime folder, which only root can create."""
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
    """Return "uid N" for a message, with an explanation for an unmapped user."""
    if uid == OVERFLOW_UID:
        return f"uid {uid} (nobody, or a user that this container does not know)"
    return f"uid {uid}"
