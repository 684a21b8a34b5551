"""What the operator's hands want, from keys: only a key that is held moves the robot."""

from __future__ import annotations

from collections.abc import Sequence
from types import MappingProxyType
from typing import Final, NamedTuple, Protocol

from robotctl.cli.terminal.key_events import ANSWER, Key, KeyEvent
from robotctl.kernel.course import MAX_SILENCE_S

REPEAT_S: Final = MAX_SILENCE_S
"""Without releases, a key that comes again within this time is held; no person types that fast."""

FIRST_REPEAT_S: Final = 0.8
"""With releases, a key that does not repeat is let go. The longest usual delay is that of X11:
660 ms; 600 ms with KDE, 500 ms with GNOME and Windows, 250 to 375 ms with macOS."""

NEXT_REPEAT_S: Final = 0.25
"""So is one whose repeats stop: they come each 25 to 50 ms, 90 ms with macOS."""

AFTER_OTHER_S: Final = 3.0
"""How long a key is held after the release of another: X11, Wayland and macOS repeat neither."""

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
    """Hands on the keys of a terminal; `problem` says why keys were let go, "" for none."""

    problem: str

    def take(self, keys: Sequence[Key], now_s: float) -> Wish | None:
        """Take the keys of this moment; return what they ask for, None without any key."""

    def forget(self) -> None:
        """Let go of every key: each must be pressed again."""


class HandsWithReleases:
    """The hands on a terminal that tells releases: a key is held from its press to its release.

    It is let go earlier if it does not repeat: then its release may be lost, with the focus of the
    window or in a multiplexer. Only the key that was pressed last repeats, so after another key
    nothing does. Text presses nothing: its release would never come.

    Each answer of the terminal asks for the held keys once more. Without any, the robot stops.
    """

    def __init__(self) -> None:
        self.problem = ""
        self._held: set[str] = set()
        self._wish = STAND
        self._heard_s = float("-inf")
        self._patience_s = 0.0

    def take(self, keys: Sequence[Key], now_s: float) -> Wish | None:
        """Return the sum of the held keys when it changes and with each answer, else None."""
        for key in keys:
            if key.name != ANSWER and not key.is_text:
                self._hear(key, now_s)
        if self._held and now_s - self._heard_s > self._patience_s:
            self._held.clear()
            self.problem = "let go: no key repeated. Press it again"
        wishes = [STAND, *(STEERING[name] for name in self._held)]
        forward, left = map(sum, zip(*wishes, strict=True))
        wish = Wish(max(-1.0, min(forward, 1.0)), max(-1.0, min(left, 1.0)))
        changes, self._wish = wish != self._wish, wish
        return wish if changes or any(key.name == ANSWER for key in keys) else None

    def forget(self) -> None:
        """Let go of every key; a repeat of one that is still down counts for nothing."""
        self._held.clear()
        self._wish = STAND

    def _hear(self, key: Key, now_s: float) -> None:
        self._heard_s = now_s
        if key.event is KeyEvent.RELEASED:
            self._held.discard(key.name)
            self._patience_s = AFTER_OTHER_S
        elif key.event is KeyEvent.REPEATED:
            self._patience_s = NEXT_REPEAT_S
        else:
            self._patience_s = FIRST_REPEAT_S
            if key.name in STEERING and not key.with_control:
                self._held.add(key.name)
                self.problem = ""


class HandsWithoutReleases:
    """The hands on a terminal that sends a held key again and again, and no release.

    The first press moves nothing, for it may be the last. After pasted text, all must rest.
    """

    def __init__(self) -> None:
        self.problem = ""
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
