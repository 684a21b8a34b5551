"""The speeds of the tutorial's velocity publisher: a triangle between two limits."""

from __future__ import annotations

STEPS_PER_MPS = 10
MAX_STEPS = 20


def sweep_mps(number: int) -> float:
    """Return the speed [m/s] of the sweep's step `number`, counted from 0.

    The steps are 0.1, 0.2 ... 2.0, 1.9 ... -2.0, -1.9 ... 0.0, and then repeat.
    """
    place = (number + 1) % (4 * MAX_STEPS)
    if place > 3 * MAX_STEPS:
        steps = place - 4 * MAX_STEPS
    elif place > MAX_STEPS:
        steps = 2 * MAX_STEPS - place
    else:
        steps = place
    return steps / STEPS_PER_MPS
