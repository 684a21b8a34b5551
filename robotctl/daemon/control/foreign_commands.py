"""Velocity commands that other nodes publish, however short their publishers live."""

from __future__ import annotations

import time
from collections.abc import Callable

from robotctl.kernel.types import Event, ForeignCommandHeard

REPEAT_NS = 200_000_000
"""How often the kernel is told again while the robot does not move; a flood must not fill the
journal."""

MAX_TOLD = 16
"""Publishers of which the kernel is told within `REPEAT_NS` while the robot does not move."""

NAMELESS = "a publisher that is gone, or has no name yet,"


class ForeignCommands:
    """Looks at the publisher of each recorded command, and tells the kernel of foreign ones.

    `name_of(gid)` returns the node that publishes with this identity, "" where unknown. While
    `moves()` the kernel is told of each command, for the first one ends the motion; otherwise of
    each publisher each 0.2 s.
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
        self._told_ns: dict[bytes, int] = {}
        """When the kernel was told of each publisher, of those that were told of just now."""

    def heard(self, gid: bytes) -> None:
        """Take the identity of the publisher of one command."""
        if gid == self._own_gid:
            return
        now_ns = time.monotonic_ns()
        if not self._moves() and not self._may_tell(gid, now_ns):
            return
        self._told_ns[gid] = now_ns
        self._dispatch(ForeignCommandHeard(now_ns, self._name_of(gid) or NAMELESS))

    def _may_tell(self, gid: bytes, now_ns: int) -> bool:
        told_ns = self._told_ns.get(gid)
        if told_ns is not None and now_ns - told_ns < REPEAT_NS:
            return False
        if len(self._told_ns) >= MAX_TOLD:
            recent = {g: t for g, t in self._told_ns.items() if now_ns - t < REPEAT_NS}
            self._told_ns = recent
        return len(self._told_ns) < MAX_TOLD
