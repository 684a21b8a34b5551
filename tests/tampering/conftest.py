"""The honest recordings that are edited, made without ROS."""

from __future__ import annotations

from dataclasses import replace

import pytest

from robotctl.config import Config
from robotctl.kernel.params import KernelParams
from robotctl.kernel.safety_inputs import EstopParams, SafetyInput, SafetyInputParams, Use
from robotctl.kernel.types import (
    Event,
    LoopStalled,
    ModeRequested,
    ResetRequested,
    SafetyInputReceived,
)
from robotctl.testing.drives import BEGIN_NS, drive_requested
from tests.support.edited_recordings import Contents
from tests.support.heard_drives import heard_drive


def after(seconds: float) -> int:
    """Return the steady time that many seconds after the beginning [ns]."""
    return BEGIN_NS + round(seconds * 1e9)


REQUESTS: dict[str, list[Event]] = {
    "stopped": [
        drive_requested(),
        ModeRequested(after(1.2), 2, 3, "the ROS service /estop"),
        ModeRequested(after(2.0), 3, 1, "the ROS service /set_mode"),
        ResetRequested(after(2.4), 4, "operator"),
    ],
    "stalled": [drive_requested(), LoopStalled(after(1.5), 0.2, 3, 0, "somewhere")],
    "pressed": [
        drive_requested(),
        *(
            SafetyInputReceived(
                after(0.05 + number / 10.0), SafetyInput.ESTOP, float(15 <= number < 22)
            )
            for number in range(35)
        ),
    ],
}
"""The requests of each recording."""

BUTTON = Config(
    kernel=replace(
        KernelParams(), inputs=SafetyInputParams(estop=EstopParams(use=Use.REQUIRED, timeout_s=0.5))
    )
)
"""The configuration of "pressed": with an emergency stop button."""


@pytest.fixture(scope="package")
def honest() -> dict[str, Contents]:
    """Return the recordings by name; "killed" was not closed."""
    made = {
        name: heard_drive(
            3.6,
            requests=requests,
            snapshots_s=(0.0, 2.0),
            config=BUTTON if name == "pressed" else None,
        )
        for name, requests in REQUESTS.items()
    }
    killed = made["stopped"].unclosed()
    del killed.messages[killed.snapshots()[-1]]
    return {**made, "killed": killed}
