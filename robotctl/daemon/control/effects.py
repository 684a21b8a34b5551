"""Passes each effect of the kernel to the part of the daemon that carries it out."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
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


class Effects:
    """Carries out each effect in the loop's thread, without blocking."""

    def __init__(
        self,
        publish_twist: Callable[[Twist], None],
        show_mode: Callable[[Mode], None],
        note: Callable[[RecordedEvent], None],
        latch: Latch,
        requests: PendingRequests,
        robot: str,
        change: Callable[[ParameterChanged], None] = lambda change: None,
        decided: Callable[[Effect], None] = lambda effect: None,
        true_errors: Callable[[int], TrueErrors | None] = lambda request_id: None,
        measured: Callable[[DriveEnded], DriveEnded] = lambda ended: ended,
    ) -> None:
        """`decided(effect)` is called for each effect except velocity commands.

        When a drive ends, `measured(ended)` returns `ended` or, if no error was measured, a copy in
        which the errors are NaN. Then `true_errors(request_id)` returns the errors of a simulated
        robot by its true pose, or None if they are unknown.
        """
        self._measured = measured
        self._true_errors = true_errors
        self._publish_twist = publish_twist
        self._show_mode = show_mode
        self._note = note
        self._latch = latch
        self._requests = requests
        self._robot = robot
        self._change = change
        self._decided = decided

    def carry_out(self, effect: Effect) -> None:
        """Carry out an effect. A thread saves a stop; replies wait until the stop is on disk."""
        if isinstance(effect, PublishTwist):
            self._publish_twist(effect.twist)
            return
        self._decided(effect)
        match effect:
            case ModeChanged():
                reason = self._with_cure(effect)
                _log.info("%s -> %s: %s", effect.previous.name, effect.mode.name, reason)
                self._show_mode(effect.mode)
                self._note_event(effect)
            case LatchEmergencyStop():
                self._latch.set(effect.reason, effect.cause or Cause.OPERATOR_STOP)
            case ReleaseEmergencyStop():
                self._latch.clear()
            case ParameterChanged():
                _log.info("%s: %s -> %s, by %s", effect.key, effect.old, effect.new, effect.source)
                self._change(effect)
            case Reply():
                if not self._requests.keep_now(effect):
                    self._latch.when_settled(partial(self._answer, effect))
            case DriveEnded():
                _log.info("drive ended: %s", self._with_cure(effect))
                measured = self._measured(effect)
                self._note_event(measured)
                self._requests.end_drive(measured)
            case _:
                assert_never(effect)

    def _note_event(self, effect: ModeChanged | DriveEnded) -> None:
        true = self._true_errors(effect.request_id) if isinstance(effect, DriveEnded) else None
        named = {} if true is None else {f"true_{n}": each for n, each in true._asdict().items()}
        event = noted_event(effect, time.time_ns(), named)
        if event is not None:
            self._note(event)

    def _with_cure(self, effect: ModeChanged | DriveEnded) -> str:
        return advice(effect.reason, remedies_for(effect.cause), self._robot).sentence

    def _answer(self, reply: Reply, problem: str) -> None:
        if problem and reply.ok:
            kind = UnsavedReply if reply.mode is Mode.EMERGENCY_STOP else Reply
            message = f"{reply.message}, but {problem}"
            reply = kind(reply.request_id, reply.ok, message, reply.mode)
        self._requests.answer(reply)
