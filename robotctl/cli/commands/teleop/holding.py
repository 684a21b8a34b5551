"""Holds a velocity of the robot to run, again and again, through one connection."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from robotctl.cli.commands.teleop.held_keys import STAND, Wish
from robotctl.errors import Refused, UsageError
from robotctl.ipc.client import Client
from robotctl.ipc.method_names import HOLD, PARAM_LIST
from robotctl.kernel.course import MAX_SILENCE_S
from robotctl.kernel.patterns import MIN_SPEED_MPS

FIRST_SHARE, STEP = 0.5, 1.1
"""The share of the limits at the start, and the factor of a step of it."""

CALL_S = 1.0
"""How long the daemon may take to answer; its robot stands long before."""


class Speeds:
    """The chosen speeds: the same share of both limits."""

    def __init__(self, client: Client, speed_mps: float | None) -> None:
        """Begin with `speed_mps`, or with FIRST_SHARE of the daemon's limits.

        Raises:
            UsageError: The speed is above the limit.
        """
        listed = client.call(PARAM_LIST)["parameters"]
        limits: dict[str, Any] = {each["key"]: each["value"] for each in listed}
        self._linear_mps: float = limits["limits.linear_mps"]
        self._angular_rps: float = limits["limits.angular_rps"]
        self._least = min(MIN_SPEED_MPS / self._linear_mps, 1.0)
        self._share = FIRST_SHARE if speed_mps is None else speed_mps / self._linear_mps
        if self._share > 1.0:
            cure = f"the limit is {self._linear_mps:g} m/s (limits.linear_mps)"
            raise UsageError(f"--speed {speed_mps:g}", cure)

    def scale(self, factor: float) -> None:
        """Multiply the speeds, within MIN_SPEED_MPS and the limits."""
        self._share = min(max(self._share * factor, self._least), 1.0)

    def velocity(self, wish: Wish) -> tuple[float, float]:
        """Return what is wanted [m/s, rad/s]; backwards, left and right stay where they are."""
        return (
            wish.forward * self._share * self._linear_mps,
            wish.left * self._share * self._angular_rps,
        )

    def __str__(self) -> str:
        linear_mps, angular_rps = self.velocity(Wish(1.0, 1.0))
        return f"{linear_mps:.2f} m/s, {angular_rps:.2f} rad/s"


class Holding:
    """The motion that is held; `message` says why the last one ended or was refused.

    Where `silence_lets_go`, a silence is how the operator ends a motion, and the next wish begins
    another one. Else it is a mishap, after which the operator must let go first.
    """

    def __init__(self, client: Client, params: Mapping[str, Any]) -> None:
        """`params` says who asks: source, reason and lease."""
        self.message = ""
        self.silence_lets_go = False
        self._client = client
        self._params = params
        self._number = 0
        self._sent_s = float("-inf")

    @property
    def is_held(self) -> bool:
        """Whether a motion is going on, as far as is known."""
        return self._number != 0

    def want(self, velocity: tuple[float, float]) -> bool:
        """Begin or go on; return False where the motion was refused or ended by something else."""
        now_s = time.monotonic()
        if self.silence_lets_go and now_s - self._sent_s >= MAX_SILENCE_S:
            self._number = 0
        begins = self._number == 0
        if begins and velocity == STAND:
            return True
        linear_mps, angular_rps = velocity
        given = {"linear_mps": linear_mps, "angular_rps": angular_rps, "hold": self._number}
        self._sent_s = now_s
        try:
            answer = self._client.call(HOLD, {**self._params, **given}, deadline_s=CALL_S)
        except Refused as refused:
            self._number, self.message = 0, str(refused)
            return False
        self._number = answer["hold"]
        if self._number:
            self.message = "" if begins else self.message
        elif velocity != STAND:
            self.message = answer["message"]
            return False
        return True
