"""Pairs each input that the kernel received with the recorded message, and says what differs.

The last messages may have been under way when the recording ended. Any message may be lost on the
way to the control loop (best effort), but hardly the last ones if no earlier one was.
"""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any, NamedTuple

from robotctl.kernel.units import NS_PER_S

PATIENCE_NS = 30 * NS_PER_S
"""How long an input waits for its message, on the steady clock of the journal."""

EDGE_NS = NS_PER_S // 2
"""The message of an input at most this long before the end of a journal may be under way.

Likewise, the messages of the first inputs of a file may be in the file before: the recorder
may receive a message earlier than the control loop does.
"""

UNFOUND_NS = 2 * NS_PER_S
"""How long the recorder may take to discover a publisher."""

MAX_WAITING = 5_000
"""The number of messages that may wait for their input."""


class Input(NamedTuple):
    """An input in the journal: its time, publisher and value; `seq` is that of its entry."""

    t_ns: int
    source: Hashable
    value: Any
    seq: int


class Sent(NamedTuple):
    """A message: its value, and when it was recorded [ns since the epoch]."""

    value: Any
    log_ns: int


class InputPairs:
    """Compares the inputs of one topic with its messages, and counts the differences."""

    def __init__(self) -> None:
        self.tolerance = 0.0
        """How far the numbers of a message may be from those of its input."""

        self.paired = 0
        self.lacking = 0
        """The number of inputs without a message, except `before_first` and those near the end."""

        self.lacking_example = ""
        self.before_first = 0
        """The number of inputs without a message before the first one that has one."""

        self.before_found = 0
        """How many of `before_first` were sent before the recorder can have found the publisher."""

        self.at_begin = 0
        """How many inputs of the first EDGE_NS came before the first one that has a message."""

        self.differing = 0
        """The number of inputs whose message holds another value."""

        self.differing_example = ""
        self.unheard = 0
        """The number of messages between paired ones that never became an input."""

        self.repeated = 0
        """The number of messages whose number is not higher than that of the message before."""

        self._inputs: dict[int, list[Input]] = {}
        self._messages: dict[int, list[Sent]] = {}
        self._found: dict[Hashable, int] = {}
        """The number that was paired last, for each publisher."""

        self._lives: dict[Hashable, tuple[int, int]] = {}
        self._unfound: list[tuple[Input, int]] = []
        self._unheard: list[tuple[int, int]] = []
        """Number and log time of each message without an input."""

        self._first_ns: int | None = None
        self._last_ns = 0
        self._numbers = (0, 0)
        """The lowest and the highest number that was paired."""

        self.later_ns: list[int] = []
        """The log times of the messages with higher numbers than all that were paired."""

        self._newest = 0
        self._t_ns = 0

    @property
    def has_one_publisher(self) -> bool:
        """Whether all inputs came from one publisher, so that their numbers are unique."""
        return len(self._lives) <= 1

    @property
    def rate_hz(self) -> float:
        """The mean rate of the messages between the first and the last paired one."""
        first, last = self._numbers
        if self._first_ns is None or self._last_ns <= self._first_ns:
            return 0.0
        return (last - first) * NS_PER_S / (self._last_ns - self._first_ns)

    def message(self, sequence: int, value: Any, log_ns: int) -> None:
        """Pair a message of the topic with its input, or keep it until the input is read."""
        self.repeated += sequence <= self._newest
        self._newest = sequence
        inputs = self._inputs.get(sequence)
        if inputs is not None:
            for each in inputs:
                if _same(each.value, value, self.tolerance):
                    self._pair(sequence, each)
                    inputs.remove(each)
                    if not inputs:
                        del self._inputs[sequence]
                    return
        self._messages.setdefault(sequence, []).append(Sent(value, log_ns))
        if len(self._messages) > MAX_WAITING:
            oldest = next(iter(self._messages))
            self._unheard += [(oldest, each.log_ns) for each in self._messages.pop(oldest)]

    def received(self, sequence: int, found: Input) -> None:
        """Pair an input of the journal with its message; it has none if `sequence` is 0."""
        self._t_ns = found.t_ns
        if not sequence:
            return
        begin_ns, _ = self._lives.get(found.source, (found.t_ns, 0))
        self._lives[found.source] = begin_ns, found.t_ns
        messages = self._messages.get(sequence)
        if messages is not None:
            for position, sent in enumerate(messages):
                if _same(found.value, sent.value, self.tolerance):
                    self._pair(sequence, found)
                    del messages[position]
                    if not messages:
                        del self._messages[sequence]
                    return
        self._inputs.setdefault(sequence, []).append(found)

    def _pair(self, sequence: int, found: Input) -> None:
        self.paired += 1
        self._found[found.source] = sequence
        if self._first_ns is None:
            self._first_ns = self._last_ns = found.t_ns
            self._numbers = sequence, sequence
        elif sequence > self._numbers[1]:
            self._numbers = self._numbers[0], sequence
            self._last_ns = found.t_ns

    def settle(self) -> None:
        """Stop waiting for the messages of old inputs; called at each snapshot."""
        for sequence, inputs in list(self._inputs.items()):
            if self._t_ns - inputs[-1].t_ns <= PATIENCE_NS:
                return  # the later inputs have waited less
            del self._inputs[sequence]
            for each in inputs:
                self._lack(sequence, each)

    def forget(self) -> None:
        """Drop the inputs and messages that wait, because journal entries are missing."""
        self._inputs.clear()
        self._messages.clear()

    def end(self, t_ns: int, stalled_ns: int = 0) -> int:
        """Count what waits at the end `t_ns`; return how many of the last inputs lack a message.

        Stalls of `stalled_ns` in total may have delayed the last messages.
        """
        near = 0
        newest = max(self._messages, default=0) if self.has_one_publisher else 0
        for sequence, inputs in self._inputs.items():
            for each in inputs:
                is_last = sequence > max(newest, self._found.get(each.source, 0))
                if (
                    is_last
                    and sequence not in self._messages
                    and t_ns - each.t_ns <= EDGE_NS + stalled_ns
                ):
                    near += 1
                else:
                    self._lack(sequence, each)
        for each, sequence in self._unfound:
            begin_ns, end_ns = self._lives.get(each.source, (0, 0))
            if each.source in self._found or end_ns - begin_ns > UNFOUND_NS:
                self._count(sequence, each)
        for sequence, messages in self._messages.items():
            self._unheard += [(sequence, each.log_ns) for each in messages]
        first, last = self._numbers
        self.unheard += sum(first < sequence < last for sequence, _ in self._unheard)
        self.later_ns = [log_ns for sequence, log_ns in self._unheard if sequence > last]
        return near

    def _lack(self, sequence: int, found: Input) -> None:
        messages = self._messages.get(sequence)
        if messages:
            self.differing += 1
            value = messages.pop().value  # it was received, with another value
            if not messages:
                del self._messages[sequence]
            self.differing_example = self.differing_example or (
                f"entry {found.seq} has {found.value}, message {sequence} has {value}"
            )
        elif found.source not in self._found:
            self._unfound.append((found, sequence))
        else:
            self._count(sequence, found)

    def _count(self, sequence: int, found: Input) -> None:
        if self._first_ns is None or found.t_ns < self._first_ns:
            earliest_ns = min(begin_ns for begin_ns, _ in self._lives.values())
            self.at_begin += found.t_ns - earliest_ns <= EDGE_NS
        if self._first_ns is not None and found.t_ns < self._first_ns:
            begin_ns, _ = self._lives[found.source]
            self.before_first += 1
            self.before_found += found.t_ns - begin_ns <= UNFOUND_NS
            return
        self.lacking += 1
        if not self.lacking_example:
            self.lacking_example = f"entry {found.seq}, message {sequence}"


def _same(one: Any, other: Any, tolerance: float) -> bool:
    if one == other or repr(one) == repr(other):  # nan differs from itself
        return True
    if not tolerance or not isinstance(one, tuple) or not isinstance(other, tuple):
        return False
    return len(one) == len(other) and all(
        abs(mine - theirs) <= tolerance for mine, theirs in zip(one, other, strict=True)
    )
