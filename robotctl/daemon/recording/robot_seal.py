"""Seals the recordings of a robot with the keys in its state folder."""

from __future__ import annotations

from collections.abc import Callable

from robotctl.base.paths import make_private, seal_folder
from robotctl.recording.format.seal_records import Link, Opening, SealOfFile
from robotctl.recording.seal.keyring import Head, Keyring


class RobotSealer:
    """The `Sealer` of a daemon; it makes the robot's key when it is first needed.

    Only the recorder's thread uses it.
    """

    def __init__(self, robot: str, on_head: Callable[[Head], None] = lambda head: None) -> None:
        """`on_head` gets each head that is kept, in the recorder's thread."""
        self._robot = robot
        self._on_head = on_head
        self._keyring: Keyring | None = None

    def open_file(self, file: str) -> SealOfFile:
        """Return the seal of a new file.

        Raises:
            RobotctlError: The state folder cannot be trusted or created.
            OSError, ValueError: There is no key.
        """
        folder = make_private(seal_folder(self._robot))
        self._keyring = Keyring(folder, self._robot, self._on_head)
        return self._keyring.open_file(file)

    def keep(self, opening: Opening, link: Link, *, closed: bool) -> None:
        """Keep a link in the state folder.

        Raises:
            OSError, ValueError: It cannot be kept.
        """
        if self._keyring is not None:
            self._keyring.keep(opening, link, closed=closed)
