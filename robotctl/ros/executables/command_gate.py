"""The decisions of a gate: which commands of the owner of the mode pass on to the robot."""

from __future__ import annotations

from collections.abc import Collection

from robotctl.kernel.types import ZERO, Twist
from robotctl.kernel.units import NS_PER_S

SILENCE_S = 0.3
"""An owner that was not heard for this long is silent, and a command this old does not pass."""


class CommandGate:
    """A gate for the commands of one owner, which is known by the gid of its publisher.

    It is closed at first, and whenever its owner is silent, late, or not alone. It opens with a
    zero of the owner, so that a gate that is started again never revives a motion.
    """

    def __init__(self, silence_s: float = SILENCE_S) -> None:
        self._silence_ns = round(silence_s * NS_PER_S)
        self._owner: bytes | None = None
        self._open = False
        self._heard_ns: int | None = None
        self._problem = ""

    @property
    def had_owner(self) -> bool:
        """Whether an owner was ever heard or found."""
        return self._owner is not None or self._heard_ns is not None

    def look(self, owners: Collection[bytes], others: str, now_ns: int) -> None:
        """Take what the graph shows: the gids of the owners, and a sentence about other publishers.

        The sentence is "" if there are none.
        """
        if self._owner is not None and self._owner not in owners:
            self._owner, self._open = None, False
        if self._owner is None and len(owners) == 1:
            (self._owner,) = owners
            self._heard_ns = now_ns
        self._problem = others
        if len(owners) > 1:
            self._problem = f"{len(owners)} nodes command this gate"
        if self._problem:
            self._open = False

    def passes(self, gid: bytes, twist: Twist, age_ns: int, now_ns: int) -> bool | None:
        """Return whether a command passes on, None if it is not the owner's.

        `age_ns` is the time since it was sent. Where it does not pass, a zero must be sent instead.
        """
        if gid != self._owner:
            return None
        self._heard_ns = now_ns
        if self._problem or abs(age_ns) > self._silence_ns:
            self._open = False
        elif twist == ZERO:
            self._open = True
        return self._open

    def closed_because(self, now_ns: int) -> str:
        """Return why zeros are sent instead of the owner's commands, "" where these pass."""
        if self._problem:
            return self._problem
        if self._owner is None:
            return "the owner of the mode is gone" if self.had_owner else ""
        assert self._heard_ns is not None, "it is set with the owner"
        if now_ns - self._heard_ns > self._silence_ns:
            self._open = False
            return "the owner of the mode is silent"
        return "" if self._open else "the owner of the mode has not commanded zero yet"

    def needs_zero(self, now_ns: int) -> bool:
        """Return whether a zero is due because nothing is heard from an owner."""
        silent = self._heard_ns is not None and now_ns - self._heard_ns > self._silence_ns
        if silent:
            self._open = False
        return self.had_owner and (silent or self._owner is None)
