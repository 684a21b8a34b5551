"""Carries out the kernel's effects in the parts of the daemon."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import assert_never

from robotctl.daemon.control.dispatcher import PendingRequests, UnsavedReply
from robotctl.daemon.control.latch import Latch
from robotctl.daemon.control.robot_report import TrueErrors
from robotctl.ipc.advice import advice
from robotctl.kernel.modes import Mode
from robotctl.kernel.safety import remedies_for
from robotctl.kernel.types import (
    Cause,
    DriveEnded,
    Effect,
    LatchEmergencyStop,
    ModeChanged,
    ParameterChanged,
    PublishTwist,
    ReleaseEmergencyStop,
    Reply,
    Twist,
)
from robotctl.recording.format.noted_events import noted_event
from robotctl.recording.format.recorded_events import RecordedEvent

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Effects:
    """Carries out the kernel's effects in the loop's thread, without blocking."""

    publish_twist: Callable[[Twist], None]
    show_mode: Callable[[Mode], None]
    note: Callable[[RecordedEvent], None]
    latch: Latch
    requests: PendingRequests
    robot: str
    change: Callable[[ParameterChanged], None] = lambda change: None
    decided: Callable[[Effect], None] = lambda effect: None
    """Called for each effect except velocity commands."""

    true_errors: Callable[[int], TrueErrors | None] = lambda request_id: None
    """Returns the errors of a drive by the simulated robot's true pose, None if unknown."""

    measured: Callable[[DriveEnded], DriveEnded] = lambda ended: ended
    """Returns an ended drive, with NaN for errors that were not measured."""

    def carry_out(self, effect: Effect) -> None:
        """Carry out an effect. A reply is sent once the latch is on the disk, or after DISK_S."""
        if isinstance(effect, PublishTwist):
            self.publish_twist(effect.twist)
            return
        self.decided(effect)
        match effect:
            case ModeChanged():
                reason = self._with_cure(effect)
                _log.info("%s -> %s: %s", effect.previous.name, effect.mode.name, reason)
                self.show_mode(effect.mode)
                self._note_event(effect)
            case LatchEmergencyStop():
                self.latch.set(effect.reason, effect.cause or Cause.OPERATOR_STOP)
            case ReleaseEmergencyStop():
                self.latch.clear()
            case ParameterChanged():
                _log.info("%s: %s -> %s, by %s", effect.key, effect.old, effect.new, effect.source)
                self.change(effect)
            case Reply():
                if not self.requests.keep_now(effect):
                    self.latch.when_settled(partial(self._answer, effect))
            case DriveEnded():
                _log.info("drive ended: %s", self._with_cure(effect))
                measured = self.measured(effect)
                self._note_event(measured)
                self.requests.ends.settle(measured)
            case _:
                assert_never(effect)

    def _note_event(self, effect: ModeChanged | DriveEnded) -> None:
        true = self.true_errors(effect.request_id) if isinstance(effect, DriveEnded) else None
        named = {} if true is None else {f"true_{n}": each for n, each in true._asdict().items()}
        event = noted_event(effect, time.time_ns(), named)
        if event is not None:
            self.note(event)

    def _with_cure(self, effect: ModeChanged | DriveEnded) -> str:
        return advice(effect.reason, remedies_for(effect.cause), self.robot).sentence

    def _answer(self, reply: Reply, problem: str) -> None:
        if problem and reply.ok:
            kind = UnsavedReply if reply.mode is Mode.EMERGENCY_STOP else Reply
            message = f"{reply.message}, but {problem}"
            reply = kind(reply.request_id, reply.ok, message, reply.mode)
        self.requests.replies.settle(reply)
