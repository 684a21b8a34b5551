"""Pairs each velocity command on the wire with its decision in the journal, by number and value.

Each decided command got the next sequence number of our publisher; the journal counts the zeros
that the watchdog sent between them. So the journal says which numbers carry which velocities. A
message with another number or velocity is of another publisher, or was not decided.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import inf

from robotctl.kernel.snapshot import Proof
from robotctl.kernel.types import (
    CommandPublishersSeen,
    Effect,
    Event,
    FaultReported,
    ForeignCommandHeard,
    LoopStalled,
    PublishTwist,
    Tick,
)
from robotctl.kernel.units import NS_PER_S
from robotctl.recording.format.records import MAX_SEQUENCE
from robotctl.rerun.command_bytes import STILL, is_zero, numbers_of, serialized
from robotctl.rerun.command_counts import CommandCounts, follows
from robotctl.rerun.journal_steps import Moments
from robotctl.rerun.other_commands import OtherCommands
from robotctl.rerun.recent_commands import RecentCommands
from robotctl.rerun.undecided_end import JOURNAL_LAG_NS, LAST_ZEROS, Early, UndecidedEnd

MAX_WAITING = 20_000
"""The number of commands, decided or sent, that may wait for their counterpart."""

TAIL_NS = 2 * NS_PER_S
"""How long before the end of a journal a decision may lack its message: it was under way."""

Decided = tuple[bytes, Moments]
"""The six numbers of a decided command, and the step that decided it."""

SEND_FAILED = f"{PublishTwist.__name__} failed"
"""How the fault of a command that could not be sent begins."""


class CommandPairs:
    """The comparison of decided and sent commands, from the first snapshot with a proof on."""

    def __init__(self) -> None:
        self.others = OtherCommands()
        self.counts = CommandCounts()
        self.is_counting = False
        self._has_ended = False
        """Whether a snapshot counts zeros that only the end of the daemon sends."""

        self._number = 0
        """The number of the last command that the journal accounts for."""

        self._base = 0
        """The number of commands before the first decision that is counted."""

        self._t_ns = self._log_ns = 0
        """When the last event was handled, on the steady clock and since the epoch."""

        self._wanted: dict[int, Decided] = {}
        self._early: dict[int, list[Early]] = {}
        """Messages before their decision, by number. Two publishers may use one number."""

        self._instead: dict[int, tuple[bytes, int]] = {}
        """Zeros where another command was decided: the next event may tell of a stall."""

        self._recent = RecentCommands()

    # The wire

    def message(self, sequence: int, data: bytes, publish_ns: int) -> None:
        """Take a message of the command topic."""
        if not self.is_counting:
            return
        numbers = numbers_of(data)
        wanted = self._wanted.get(sequence)
        if wanted is None:
            self._keep(sequence, numbers, publish_ns)
        elif wanted[0] == numbers or (numbers == STILL and is_zero(wanted[0])):
            del self._wanted[sequence]
            self.counts.pair(sequence, wanted[1], publish_ns)
        elif numbers == STILL:
            self._instead[sequence] = numbers, publish_ns
        else:
            self.others.doubt(self._t_ns, numbers)

    def _keep(self, sequence: int, numbers: bytes, publish_ns: int) -> None:
        """Keep a message that is not decided yet, or doubt it."""
        if follows(sequence, self._number):
            self._early.setdefault(sequence, []).append(Early(numbers, publish_ns, self._t_ns))
            if len(self._early) > MAX_WAITING:
                self._doubt_all(self._early.pop(next(iter(self._early))))
        elif self.counts.has_begun or not self._base:
            self.others.doubt(self._t_ns, numbers)  # else decided before the recording begins

    def _doubt_all(self, messages: Iterable[Early]) -> None:
        for numbers, _, t_ns in messages:
            self.others.doubt(t_ns, numbers)

    # The journal

    def resume(self, proof: Proof) -> None:
        """Continue from a snapshot, with the number of commands that it tells."""
        differs = proof.commands & MAX_SEQUENCE != self._number
        was_moving = self._recent.were_moving
        more = (proof.commands - self._number) & MAX_SEQUENCE
        if self.is_counting and was_moving and 0 < more <= LAST_ZEROS:
            self._has_ended = True
            while proof.commands & MAX_SEQUENCE != self._number:
                self._decide(STILL, (self._t_ns, 0, 0))
            return
        self.counts.resumed += self.is_counting and differs
        if not self.is_counting or differs:
            self._forget()
            self._number = self._base = proof.commands & MAX_SEQUENCE
            self.is_counting = True

    def stop(self) -> None:
        """Pause until the next snapshot: events are missing."""
        self.is_counting = False
        self._forget()

    def _forget(self) -> None:
        self._wanted.clear()
        self._early.clear()
        self._instead.clear()
        self._recent.clear()
        self.counts.begin_again()

    def step(self, event: Event, effects: tuple[Effect, ...], moments: Moments) -> None:
        """Note an event and its effects: the commands that messages must be found for."""
        if not self.is_counting:
            return
        self._t_ns, self._log_ns, _ = moments
        if self._has_ended:
            self.counts.resumed += 1
            self._has_ended = False
        if isinstance(event, Tick):
            self._settle()
        elif isinstance(event, LoopStalled):
            self._stall(event, moments)
        elif isinstance(event, ForeignCommandHeard):
            self.others.hear(event.t_ns)
        elif isinstance(event, CommandPublishersSeen):
            self.others.publish(event.t_ns, bool(event.names))
        elif isinstance(event, FaultReported) and SEND_FAILED in event.detail:
            self.counts.unsent = True  # it is not known which: the next snapshot counts again
            self.stop()
            return
        for effect in effects:
            if isinstance(effect, PublishTwist):
                self._decide(serialized(effect.twist), moments)

    def _decide(self, numbers: bytes, moments: Moments) -> None:
        self._number = number = (self._number + 1) & MAX_SEQUENCE
        self._recent.add(number, numbers)
        early = self._early.pop(number, None)
        if early is None:
            self._wanted[number] = numbers, moments
        else:
            self._decide_late(number, (numbers, moments), early)
        if len(self._wanted) > MAX_WAITING:
            number, (numbers, _) = next(iter(self._wanted.items()))
            del self._wanted[number]
            self.counts.lack(number, numbers)

    def _decide_late(self, number: int, decided: Decided, early: list[Early]) -> None:
        """Take a decision after the messages with its number."""
        numbers, moments = decided
        own = next((each for each in early if each[0] == numbers), None)
        if own is not None:
            self.counts.pair(number, moments, own[1])
        else:
            self._wanted[number] = decided
            own = next((each for each in early if each[0] == STILL), None)
            if own is not None:
                self._instead[number] = own[:2]
        self._doubt_all(each for each in early if each is not own)

    def _stall(self, event: LoopStalled, moments: Moments) -> None:
        """Count the zeros of the watchdog; withheld commands were sent as zeros."""
        steady_ns, begin_ns, end_ns = moments
        began_ns = max(begin_ns - round(event.stalled_s * NS_PER_S), 1) if begin_ns else 0
        during = steady_ns, began_ns, end_ns
        for number in self._recent.withheld(event.withheld):
            if number in self._wanted:
                self._wanted[number] = STILL, during
            if number in self._instead:
                _, publish_ns = self._instead.pop(number)
                del self._wanted[number]
                self.counts.pair(number, during, publish_ns)
        self._recent.clear()
        for _ in range(min(event.zeros, MAX_WAITING)):
            self._decide(STILL, during)

    def _settle(self) -> None:
        """Doubt the zeros that no stall explains, and messages that no publisher explains."""
        if self._instead:
            for numbers, _ in self._instead.values():
                self.others.doubt(self._t_ns, numbers)
            self._instead.clear()
        self.others.settle(self._t_ns)

    def end(self, cut: int = 0, *, is_own: bool = True, is_closed: bool = True) -> tuple[int, int]:
        """Count what still waits; return how many of the last decided commands are missing.

        The first number is of those that were decided more than TAIL_NS before the end, the second
        of the others. Up to `cut` messages may belong to decisions after the end. A journal that
        the recorder did not write itself may end before the recording.
        """
        end = UndecidedEnd(self._number, self._log_ns, cut, is_own, is_closed)
        unexplained = [*end.unexplained(self._early)]
        self.counts.undecided = sum(map(len, self._early.values())) - len(unexplained)
        self._doubt_all(unexplained)
        for number, (_, publish_ns) in self._instead.items():  # the end fell into a stall
            self.counts.pair(number, self._wanted.pop(number)[1], publish_ns)
        old = recent = 0
        for number, (_, moments) in list(self._wanted.items()):
            if self.counts.is_passed(number):
                self.counts.lack(number, self._wanted.pop(number)[0])
            elif self._t_ns - moments[0] > TAIL_NS:
                old += 1
            else:
                recent += 1
        self.others.end(inf if is_own else self._t_ns - JOURNAL_LAG_NS)
        return old, recent
