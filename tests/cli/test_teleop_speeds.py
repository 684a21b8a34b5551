"""The speeds of `robotctl teleop`: what is asked for is what is driven, or it is refused."""

from __future__ import annotations

from typing import Any, cast

import pytest

from robotctl.base.errors import UsageError
from robotctl.cli.commands.teleop.controls import STEP, Speeds, Wish
from robotctl.ipc.client import Client

LIMITS = {"limits.linear_mps": 0.6, "limits.angular_rps": 1.5}


class Daemon:
    """A daemon with these limits."""

    def call(self, method: object) -> dict[str, Any]:
        return {"parameters": [{"key": key, "value": value} for key, value in LIMITS.items()]}


def speeds(speed_mps: float | None) -> Speeds:
    return Speeds(cast("Client", Daemon()), speed_mps)


@pytest.mark.parametrize("asked", [0.01, 0.02, 0.3, 0.6])
def test_the_speed_that_is_asked_for_is_driven(asked: float) -> None:
    linear_mps, angular_rps = speeds(asked).velocity(Wish(1.0, 1.0))
    assert linear_mps == pytest.approx(asked)
    assert angular_rps / 1.5 == pytest.approx(asked / 0.6)


def test_a_speed_above_the_limit_is_refused_with_the_limit() -> None:
    with pytest.raises(UsageError, match=r"--speed 0\.61: the limit is 0\.6 m/s"):
        speeds(0.61)


def test_the_keys_scale_the_speeds_within_the_limits() -> None:
    chosen = speeds(None)
    assert str(chosen) == "0.30 m/s, 0.75 rad/s"
    for _ in range(100):
        chosen.scale(STEP)
    assert chosen.velocity(Wish(1.0, 1.0)) == (0.6, 1.5)
    for _ in range(100):
        chosen.scale(1.0 / STEP)
    assert chosen.velocity(Wish(1.0, 0.0))[0] == pytest.approx(0.01)
