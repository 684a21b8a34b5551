"""Velocity commands that other nodes publish, however short their publishers live."""

from __future__ import annotations

import time
from collections.abc import Callable

from robotctl.kernel.types import Event, ForeignCommandHeard

REPEAT_NS = 200_000_000
"""How often the kernel is told again while the robot does not move; a flood must not fill the
journal."""

NAMELESS = "a publisher that is gone, or has no name yet,"


class ForeignCommands:
    """Looks at the publisher of each recorded command, and tells the kernel of foreign ones.

    `name_of(gid)` returns the node that publishes with this identity, "" where unknown. While
    `moves()` the kernel is told of each command, for the first one ends the motion; otherwise each
    0.2 s.
    """

    def __init__(
        self,
        own_gid: bytes,
        name_of: Callable[[bytes], str],
        moves: Callable[[], bool],
        dispatch: Callable[[Event], None],
    ) -> None:
        self._own_gid = own_gid
        self._name_of = name_of
        self._moves = moves
        self._dispatch = dispatch
        self._gid = b""
        self._name = ""
        self._told_ns = -REPEAT_NS

    def heard(self, gid: bytes) -> None:
        """Take the identity of the publisher of one command."""
        if gid == self._own_gid:
            return
        now_ns = time.monotonic_ns()
        if now_ns - self._told_ns < REPEAT_NS and not self._moves():
            return
        if gid != self._gid or self._name == NAMELESS:
            self._gid, self._name = gid, self._name_of(gid) or NAMELESS
        self._told_ns = now_ns
        self._dispatch(ForeignCommandHeard(now_ns, self._name))
