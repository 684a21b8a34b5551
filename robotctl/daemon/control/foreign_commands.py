"""Velocity commands of other nodes, even if their publishers live only for a moment."""

from __future__ import annotations

import time
from collections.abc import Callable

from robotctl.kernel.types import Event, ForeignCommandHeard

REPEAT_NS = 200_000_000
"""The shortest time between two events about one publisher while the robot does not move.

A flood of commands must not fill the journal."""

MAX_TOLD = 16
"""The most publishers with an event within `REPEAT_NS` while the robot does not move."""

NAMELESS = "a publisher that is gone, or has no name yet,"


class ForeignCommands:
    """A check of the publisher of each command; a foreign command becomes an event.

    `name_of(gid)` returns the name of the node with this publisher, "" if unknown. While `moves()`
    returns true, each foreign command is an event: the first one ends the motion. Otherwise there
    is one event in 0.2 s about each publisher.
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
        """Time of the last event of each recent publisher [steady ns]."""

    def heard(self, gid: bytes) -> None:
        """Handle one command of the publisher with this gid."""
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
