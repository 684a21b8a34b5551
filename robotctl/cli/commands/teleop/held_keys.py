"""What the operator's hands want, from keys: only a key that is held moves the robot."""

from __future__ import annotations

from collections.abc import Iterable
from types import MappingProxyType
from typing import Final, NamedTuple, Protocol

from robotctl.cli.terminal.key_events import Key, KeyEvent
from robotctl.kernel.course import MAX_SILENCE_S

REPEAT_S: Final = MAX_SILENCE_S
"""Without releases, a key that comes again within this time is held; no person types that fast."""


class Wish(NamedTuple):
    """Shares of the speeds that are chosen, -1 to 1: forward, and turning to the left."""

    forward: float
    left: float


STAND: Final = Wish(0.0, 0.0)

STEERING: Final = MappingProxyType(
    {
        **dict.fromkeys(("up", "w"), Wish(1.0, 0.0)),
        **dict.fromkeys(("down", "s"), Wish(-1.0, 0.0)),
        **dict.fromkeys(("left", "a"), Wish(0.0, 1.0)),
        **dict.fromkeys(("right", "d"), Wish(0.0, -1.0)),
    }
)
"""The keys that steer."""


class Hands(Protocol):
    """Hands on the keys of a terminal."""

    def take(self, keys: Iterable[Key], now_s: float) -> Wish | None:
        """Take the keys of this moment; return what they ask for, None without any key."""

    def forget(self) -> None:
        """Let go of every key: each must be pressed again."""


class HandsWithReleases:
    """The hands on a terminal that tells releases: a key is held from its press to its release."""

    def __init__(self) -> None:
        self._held: set[str] = set()

    def take(self, keys: Iterable[Key], now_s: float) -> Wish | None:
        """Return the sum of the held keys; STAND when all are released."""
        for key in keys:
            if key.event is KeyEvent.RELEASED:
                self._held.discard(key.name)
            elif key.event is KeyEvent.PRESSED and key.name in STEERING and not key.with_control:
                self._held.add(key.name)
        wishes = [STAND, *(STEERING[name] for name in self._held)]
        forward, left = map(sum, zip(*wishes, strict=True))
        return Wish(max(-1.0, min(forward, 1.0)), max(-1.0, min(left, 1.0)))

    def forget(self) -> None:
        """Let go of every key; a repeat of one that is still down counts for nothing."""
        self._held.clear()


class HandsWithoutReleases:
    """The hands on a terminal that sends a held key again and again, and no release.

    The first press moves nothing, for it may be the last.
    """

    def __init__(self) -> None:
        self._last = ""
        self._last_s = float("-inf")
        self._is_forgotten = False

    def take(self, keys: Iterable[Key], now_s: float) -> Wish | None:
        """Return the wish of a key that has come again; None in each other moment."""
        names = [key.name for key in keys if key.name in STEERING]
        if not names:
            return None
        name = names[-1]  # keys that arrive at once are no repeats: they may have waited
        is_soon = now_s - self._last_s <= REPEAT_S
        repeats = name == self._last and is_soon
        self._is_forgotten = self._is_forgotten and is_soon
        self._last, self._last_s = name, now_s
        return STEERING[name] if repeats and not self._is_forgotten else None

    def forget(self) -> None:
        """Let go; a key that still repeats must rest first."""
        self._is_forgotten = True
