"""Checks the robot statuses against the journal: name, order of the modes, battery level."""

from __future__ import annotations

import struct
from collections import deque
from math import isnan, nan

from robotctl.cdr.reader import CdrReader
from robotctl.kernel.battery import is_level
from robotctl.kernel.modes import Mode
from robotctl.kernel.snapshot import Snapshot
from robotctl.kernel.types import BatteryReceived, Effect, Event, ModeChanged
from robotctl.kernel.units import NS_PER_S
from robotctl.recording import RecordingInfo
from robotctl.recording.read.messages import Message
from robotctl.rerun.check_report import Report
from robotctl.rerun.ending import Ending
from robotctl.rerun.own_topics import full_name

TYPE = "robot_controller/msg/RobotStatus"

MAX_CHANGES = 100_000
"""The number of changes of the mode that are compared."""

MAX_LEVELS = 256
"""How many battery levels are remembered; a status shows one of them."""

EDGE_NS = 2 * NS_PER_S
"""How long before the end a change of the mode may lack its status: it was under way."""

_FLOAT = struct.Struct("<f")
_UNKNOWN = _FLOAT.pack(nan)


class StatusCheck:
    """The comparison of the statuses with the modes of the journal, from its first snapshot on."""

    def __init__(self, report: Report, info: RecordingInfo, journal_topic: str) -> None:
        name = full_name(info, journal_topic, "", "robot_status")
        known = {(topic.name, topic.type_name) for topic in info.topics}
        self.topic = name if (name, TYPE) in known else None
        self.is_on = False
        self._report = report
        self._modes: list[tuple[Mode, int]] = []
        """Each mode of the journal, and when it began."""

        self._shown: list[int] = []
        """Each mode of the statuses."""

        self._newest = 0
        self._gaps = 0
        self._seen = 0
        self._levels: deque[bytes] = deque(maxlen=MAX_LEVELS)
        self._doubtful: list[bytes] = []
        self._wrong = 0
        self._example = ""
        self._t_ns = 0

    def message(self, message: Message) -> None:
        """Take a status; the last one is repeated at the beginning of each file and clip.

        That one shows the battery level of before its journal.
        """
        if message.sequence == self._newest and self._seen:
            return
        try:
            reader = CdrReader(message.data)
            name, (mode,) = reader.text(), reader.take("B")
            (level,) = reader.take("f")
        except struct.error:
            self._blame("one that cannot be read")
            return
        self._gaps += max(message.sequence - self._newest - 1, 0) if self._seen else 0
        if message.sequence < self._newest:
            self._blame("one out of order")
        self._newest = message.sequence
        self._seen += 1
        if self._report.robot and name != self._report.robot:
            self._blame(f"one of {name[:40]!r}")
        if (not self._shown or self._shown[-1] != mode) and len(self._shown) < MAX_CHANGES:
            self._shown.append(mode)
        shown = _UNKNOWN if isnan(level) else _FLOAT.pack(level)
        is_older = self._seen == 1 and message.publish_ns < self._report.begin_log_ns
        if shown not in self._levels and not is_older:
            self._doubtful.append(shown)

    def snapshot(self, snapshot: Snapshot) -> None:
        """Continue from a snapshot."""
        if snapshot.proof is None:
            return
        self.is_on = True
        self._learn(snapshot.state.health.battery_level)
        self._enter(snapshot.state.mode)
        self._settle()

    def step(self, event: Event, effects: tuple[Effect, ...], level: float | None) -> None:
        """Take an event with its effects, and the battery level after it if it is known."""
        self._t_ns = event.t_ns
        for effect in effects:
            if isinstance(effect, ModeChanged):
                self._enter(effect.mode)
        if isinstance(event, BatteryReceived) and level is not None:
            self._learn(level)

    def _enter(self, mode: Mode) -> None:
        if (not self._modes or self._modes[-1][0] is not mode) and len(self._modes) < MAX_CHANGES:
            self._modes.append((mode, self._t_ns))

    def _learn(self, level: float | None) -> None:
        packed = _FLOAT.pack(level) if is_level(level) else _UNKNOWN
        if packed not in self._levels:
            self._levels.append(packed)
            self._doubtful = [shown for shown in self._doubtful if shown != packed]

    def _settle(self) -> None:
        """Blame the levels that no battery level explains."""
        for shown in self._doubtful:
            self._blame(f"one with the battery level {_FLOAT.unpack(shown)[0]:.6g}")
        self._doubtful.clear()

    def end(self, ending: Ending) -> None:
        """Report what differs."""
        if not self.is_on or not ending.is_own or self._report.missing:
            return
        if self.topic is None:
            return
        self._settle()
        if self._wrong:
            self._report.miss(f"{self._wrong} robot statuses are wrong: {self._example}")
        if self._gaps > ending.lost and ending.ledger is not None:
            self._report.miss(f"{self._gaps} robot statuses are missing")
        elif not self._is_in_order(ending):
            modes = ", ".join(mode.name for mode, _ in self._modes[:8])
            shown = ", ".join(_name(mode) for mode in self._shown[:8])
            self._report.miss(
                f"the robot statuses do not show the modes of the journal: {shown or 'none'}, "
                f"and not {modes}"
            )

    def _is_in_order(self, ending: Ending) -> bool:
        """Return whether the statuses show the modes one after the other, as far as they must."""
        modes = [mode.value for mode, _ in self._modes]
        due = sum(self._t_ns - began_ns > EDGE_NS for _, began_ns in self._modes)
        if max(len(modes), len(self._shown)) >= MAX_CHANGES:
            return True
        if ending.is_clip or not ending.is_whole or self._gaps:
            return True  # the beginning or the end is in another file, or some are lost
        return self._shown == modes[: len(self._shown)] and len(self._shown) >= due

    def _blame(self, text: str) -> None:
        self._wrong += 1
        self._example = self._example or text


def _name(mode: int) -> str:
    return Mode(mode).name if mode in [each.value for each in Mode] else str(mode)
