"""What the operator's hands want, from keys: only a key that is held moves the robot."""

from __future__ import annotations

from collections.abc import Sequence
from types import MappingProxyType
from typing import Final, NamedTuple, Protocol

from robotctl.cli.terminal.key_events import Key, KeyEvent
from robotctl.kernel.course import MAX_SILENCE_S

REPEAT_S: Final = MAX_SILENCE_S
"""Without releases, a key that comes again within this time is held; no person types that fast."""

MAX_AT_ONCE: Final = 8
"""More keys at once are no hand: the fastest repeat brings 5 in the longest silence."""


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

STOPPING: Final = frozenset(" eq")
"""The keys that only stop: they count in every form, also as pasted text."""


def typed(keys: list[Key], *, tells_releases: bool) -> list[Key]:
    """Return the keys without text that no hand has typed, of which those that stop remain.

    A terminal that tells releases sends no key as text. Elsewhere too much text at once is no hand.
    """
    if not tells_releases and len(keys) <= MAX_AT_ONCE:
        return keys
    return [key for key in keys if not key.is_text or key.name in STOPPING]


class Hands(Protocol):
    """Hands on the keys of a terminal."""

    def take(self, keys: Sequence[Key], now_s: float) -> Wish | None:
        """Take the keys of this moment; return what they ask for, None without any key."""

    def forget(self) -> None:
        """Let go of every key: each must be pressed again."""


class HandsWithReleases:
    """The hands on a terminal that tells releases: a key is held from its press to its release.

    Text presses nothing: its release would never come.
    """

    def __init__(self) -> None:
        self._held: set[str] = set()

    def take(self, keys: Sequence[Key], now_s: float) -> Wish | None:
        """Return the sum of the held keys; STAND when all are released."""
        for key in keys:
            if key.event is KeyEvent.RELEASED:
                self._held.discard(key.name)
            elif key.event is KeyEvent.PRESSED and _steers(key):
                self._held.add(key.name)
        wishes = [STAND, *(STEERING[name] for name in self._held)]
        forward, left = map(sum, zip(*wishes, strict=True))
        return Wish(max(-1.0, min(forward, 1.0)), max(-1.0, min(left, 1.0)))

    def forget(self) -> None:
        """Let go of every key; a repeat of one that is still down counts for nothing."""
        self._held.clear()


def _steers(key: Key) -> bool:
    """Return whether the key steers and will be released."""
    return key.name in STEERING and not (key.with_control or key.is_text)


class HandsWithoutReleases:
    """The hands on a terminal that sends a held key again and again, and no release.

    The first press moves nothing, for it may be the last. After pasted text, all must rest.
    """

    def __init__(self) -> None:
        self._last = ""
        self._last_s = float("-inf")
        self._is_forgotten = False

    def take(self, keys: Sequence[Key], now_s: float) -> Wish | None:
        """Return the wish of a key that has come again; None in each other moment."""
        names = [key.name for key in keys if key.name in STEERING]
        is_pasted = len(keys) > MAX_AT_ONCE
        if not (names or is_pasted):
            return None
        name = names[-1] if names else ""  # keys at once are no repeats: they may have waited
        is_soon = now_s - self._last_s <= REPEAT_S
        repeats = name == self._last and is_soon
        self._is_forgotten = is_pasted or (self._is_forgotten and is_soon)
        self._last, self._last_s = name, now_s
        return STEERING[name] if names and repeats and not self._is_forgotten else None

    def forget(self) -> None:
        """Let go; a key that still repeats must rest first."""
        self._is_forgotten = True
