"""The report of a commissioning: lines for a reader, warnings, and the configuration file."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping

from robotctl.commission.measure import Measured
from robotctl.commission.propose import Proposal


def measured_lines(base: Measured) -> Iterator[str]:
    """Yield a line for each measured property."""
    delay_s = base.odometry_delay_s
    came = "its clock is another" if delay_s is None else f"{delay_s * 1e3:.1f} ms after its stamp"
    yield (
        f"odometry       {base.odometry_hz:.1f} Hz, {base.odometry_gap_s * 1e3:.0f} ms apart at "
        f"most, {came}"
    )
    yield f"speed          {base.reached_mps:.3f} m/s where {base.commanded_mps:.3f} was commanded"
    yield f"command delay  {base.command_delay_s:.2f} s until odometry follows"
    yield f"stopping       {base.stopping_m:.3f} m and {base.stopping_s:.2f} s after a zero"
    if base.base_timeout_s is None:
        yield f"base timeout   none within {base.quiet_s:g} s"
    else:
        yield f"base timeout   {base.base_timeout_s:.2f} s after the last command"
    turn = base.turn
    if turn is None:
        yield "turning        not on its place"
    else:
        rates = f"{turn.reached_rps:.3f} rad/s where {turn.commanded_rps:.3f} was commanded"
        yield f"turning        {rates}"
        yield f"  delay        {turn.command_delay_s:.2f} s until odometry follows"
        yield f"  stopping     {turn.stopping_rad:.3f} rad and {turn.stopping_s:.2f} s after a zero"


def warnings(base: Measured) -> Iterator[str]:
    """Yield a sentence for each property that is a danger, or makes a figure doubtful."""
    if base.base_timeout_s is None:
        yield (
            f"the base went on for {base.quiet_s:g} s without a command: if robotctl is killed, "
            "only its own emergency stop stops it"
        )
    if base.odometry_delay_s is None:
        yield (
            f"odometry is stamped by a clock that differs by {base.clock_offset_s:.1f} s: "
            "its delay is unknown, and part of the command delay"
        )
    share = base.reached_mps / base.commanded_mps
    if abs(share - 1.0) > SPEED_TOLERANCE:
        yield f"the base drove {share:.0%} of the commanded speed: see its wheel parameters"
    if base.turn is None:
        yield (
            "the base did not turn on its place: limits.angular_rps is as it was, and patterns "
            "with corners need a base that can"
        )
    elif abs(base.turn.reached_rps / base.turn.commanded_rps - 1.0) > SPEED_TOLERANCE:
        share = base.turn.reached_rps / base.turn.commanded_rps
        yield f"the base turned at {share:.0%} of the commanded rate: see its wheel separation"


SPEED_TOLERANCE = 0.1


def file_lines(
    robot: str, base: Measured, settings: Mapping[str, object], proposed: list[Proposal]
) -> Iterator[str]:
    """Yield the lines of a configuration file with the settings and the proposals."""
    yield f"# Proposed by robotctl commission for robot {robot}, from motions at"
    yield f"# {base.commanded_mps:g} m/s. Read it before you use it."
    yield "#"
    for line in (*measured_lines(base), *(f"warning: {text}" for text in warnings(base))):
        yield f"# {line}"
    yield ""
    for each in proposed:
        yield f"{each.key}: {each.value:g}  # {each.why}"
    keys = {each.key for each in proposed}
    for key, value in settings.items():
        if key not in keys:
            yield f"{key}: {json.dumps(value)}"
