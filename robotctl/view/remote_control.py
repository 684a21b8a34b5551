"""Control of the robot by viewers with `--control`."""

from __future__ import annotations

import asyncio
import json
import math
import os
from collections import Counter
from collections.abc import Coroutine
from contextlib import ExitStack, suppress
from typing import Any, Final

from robotctl.base.errors import Refused, RobotctlError
from robotctl.ipc.client import Client, call
from robotctl.ipc.method_names import HOLD, SET_MODE
from robotctl.ipc.protocol import EMERGENCY_STOP_MODE
from robotctl.kernel.constants import TWIST
from robotctl.kernel.course import MAX_SILENCE_S
from robotctl.view.foxglove import (
    ClientMessage,
    Offer,
    ServiceCall,
    ViewService,
    WrongRequest,
    service_failure,
    service_response,
    warning,
)
from robotctl.view.server import ViewServer
from robotctl.view.viewer import Viewer

ESTOP: Final = ViewService(1, "/estop")
STOP: Final = ViewService(2, "/stop")
SERVICES: Final = (ESTOP, STOP)

IDLE_MODE: Final = 0
_MODES: Final = {ESTOP.id: EMERGENCY_STOP_MODE, STOP.id: IDLE_MODE}

_STAND: Final = (0.0, 0.0)

LET_GO_S: Final = 1.0
"""How long the operator must send nothing between a refused or ended motion and a new one."""

# With one call for the velocity they fill the five threads of the loop's pool on one core.
MAX_CALLS: Final = {ESTOP.id: 3, STOP.id: 1}
"""Limit on the unanswered calls of each service, so that no call waits for a thread."""

CALL_S: Final = 1.0
"""Timeout for the daemon's answer to a velocity."""


class RemoteControl:
    """Forwards requests of viewers to the daemon, through its control socket."""

    def __init__(self, robot: str, server: ViewServer, lease: str) -> None:
        """`lease` is the token of the lease, "" if viewers may only stop the robot."""
        self._robot = robot
        self._server = server
        self._source = f"robotctl view (uid {os.getuid()}, pid {os.getpid()})"
        self._lease = lease
        self._tasks: set[asyncio.Task[None]] = set()
        self._calls: Counter[int] = Counter()
        self._driver: Viewer | None = None
        self._wish: tuple[float, float] | None = None
        self._wished = asyncio.Event()
        server.on_call = self._call
        if lease:
            server.on_offer = self._check_offer
            server.on_message = self._take_velocity

    # Services

    def _call(self, viewer: Viewer, request: ServiceCall) -> None:
        """Forward a service call to the daemon, or answer with the reason of a refusal."""
        failure = ""
        if request.service_id not in _MODES:
            failure = "there is no such service"
        elif self._calls[request.service_id] >= MAX_CALLS[request.service_id]:
            failure = "the same was asked for already, and is not answered yet"
        if failure:
            viewer.tell(service_failure(request.service_id, request.call_id, failure))
            return
        self._calls[request.service_id] += 1
        self._start(self._answer(viewer, request))

    async def _answer(self, viewer: Viewer, request: ServiceCall) -> None:
        params = {"mode": _MODES[request.service_id], "source": self._source}
        if self._lease:
            params["lease"] = self._lease
        try:
            answer = await asyncio.to_thread(call, self._robot, SET_MODE, params)
        except RobotctlError as error:
            result = {"success": False, "message": str(error)}
        else:
            result = {"success": True, "message": answer["message"]}
        finally:
            self._calls[request.service_id] -= 1
        viewer.tell(service_response(request.service_id, request.call_id, result))

    # Motion

    def _check_offer(self, offer: Offer) -> None:
        if offer.type_name != TWIST or offer.encoding != "json":
            raise WrongRequest(f"this view takes {TWIST} in JSON, and moves the robot by it")

    def _take_velocity(self, viewer: Viewer, message: ClientMessage) -> None:
        """Note the newest velocity that a viewer wants, or raise WrongRequest."""
        velocity = velocity_of(message.data)
        if self._driver is None:
            self._driver = viewer
            self._start(self._drive(viewer))
        elif self._driver is not viewer:
            raise WrongRequest("another viewer drives")
        self._wish = velocity
        self._wished.set()

    async def _drive(self, viewer: Viewer) -> None:
        """Send the wanted velocities to the daemon until a pause of MAX_SILENCE_S."""
        try:
            with ExitStack() as stack:
                # In a thread, because a busy daemon makes a client wait for seconds.
                client = await asyncio.to_thread(stack.enter_context, Client(self._robot))
                number = 0
                while await self._has_wish(MAX_SILENCE_S):
                    velocity, self._wish = self._wish or _STAND, None
                    if number == 0 and velocity == _STAND:
                        continue
                    given = {
                        "linear_mps": velocity[0],
                        "angular_rps": velocity[1],
                        "hold": number,
                        "source": self._source,
                        "lease": self._lease,
                    }
                    answer = await asyncio.to_thread(client.call, HOLD, given, deadline_s=CALL_S)
                    number = answer["hold"]
                    if number == 0 and velocity != _STAND:
                        raise Refused(answer["message"])
        except RobotctlError as error:
            text = f"{error} (let go, then hold again)"
            viewer.tell(warning(text, "drive"))
            while await self._has_wish(LET_GO_S):  # the operator still sends velocities
                self._wish = None
        finally:
            self._driver = None

    async def _has_wish(self, silence_s: float) -> bool:
        """Return whether a wanted velocity comes within `silence_s` [s]."""
        with suppress(TimeoutError):
            async with asyncio.timeout(silence_s):
                await self._wished.wait()
        self._wished.clear()
        return self._wish is not None

    def _start(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)


def velocity_of(data: bytes) -> tuple[float, float]:
    """Return linear.x [m/s] and angular.z [rad/s] of a Twist in JSON.

    Raises:
        WrongRequest: `data` is no Twist, a number is not finite, or another component is not 0.
    """
    try:
        said = json.loads(data)
        velocity = float(said["linear"]["x"]), float(said["angular"]["z"])
        others = [said["linear"].get(axis, 0.0) for axis in "yz"]
        others += [said["angular"].get(axis, 0.0) for axis in "xy"]
    except (ValueError, RecursionError, KeyError, TypeError, AttributeError, OverflowError):
        raise WrongRequest(f"a message that is no {TWIST} in JSON") from None
    if not all(map(math.isfinite, velocity)) or any(others):
        raise WrongRequest("a velocity that this robot cannot have")
    return velocity
