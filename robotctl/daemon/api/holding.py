"""The method of the control socket by which a client holds a velocity to run."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from robotctl.daemon.api.reply_or_error import granted
from robotctl.daemon.control.dispatcher import Control
from robotctl.ipc.answers import HoldAnswer
from robotctl.ipc.method import Method
from robotctl.ipc.method_names import HOLD
from robotctl.ipc.params import HoldParams
from robotctl.kernel.course import MAX_SILENCE_S, Course, Held
from robotctl.kernel.types import DriveRequested, HoldReceived, Twist
from robotctl.paths import DEFAULT_ROBOT


class HoldMethods:
    """The handler; the client calls it again and again, for silence ends the motion."""

    def __init__(
        self,
        control: Control,
        robot: str = DEFAULT_ROBOT,
        client_of: Callable[[str | None], int] = lambda token: 0,
    ) -> None:
        """`client_of(token)` returns the number of the client that has the token of a lease."""
        self._control = control
        self._robot = robot
        self._client_of = client_of

    def table(self) -> dict[str, Method[Any]]:
        """Return every method by its name."""
        return {HOLD: Method(HoldParams, self._hold)}

    async def _hold(self, params: HoldParams) -> HoldAnswer:
        if params.hold:
            return self._hold_again(params)
        request_id, now_ns = self._control.new_request_id(), time.monotonic_ns()
        held = Held(params.linear_mps, params.angular_rps, MAX_SILENCE_S, now_ns)
        event = DriveRequested(
            now_ns,
            request_id,
            self._control.params.pattern,
            1,
            False,
            params.source,
            self._client_of(params.lease),
            params.reason,
            Course(held=held),
        )
        answer = granted(await self._control.request(event), self._robot)
        return {"message": answer["message"], "mode": answer["mode"], "hold": request_id}

    def _hold_again(self, params: HoldParams) -> HoldAnswer:
        wanted = Twist(params.linear_mps, params.angular_rps)
        client = self._client_of(params.lease)
        self._control.dispatch(HoldReceived(time.monotonic_ns(), params.hold, wanted, client))
        state = self._control.state
        goes_on = state.drive is not None and state.drive.request_id == params.hold
        return {
            "message": state.reason,
            "mode": state.mode.name,
            "hold": params.hold if goes_on else 0,
        }
