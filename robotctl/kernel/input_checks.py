"""Checks for the rules about safety inputs and scans; see `kernel.checks.Check`.

They run at each tick, so each check returns early if its input is off.
"""

from __future__ import annotations

from math import inf, isnan

from robotctl.kernel.params import KernelParams
from robotctl.kernel.safety_inputs import InputParams, Reading, SafetyInput, Use
from robotctl.kernel.state import Health
from robotctl.kernel.units import NS_PER_S

LEVEL_OF_ERROR = 2.0
"""The value of DiagnosticStatus.ERROR; STALE is higher, so it is an error, too."""

_ESTOP, _JOY, _BUMPER, _TILT, _DIAGNOSTICS = range(len(SafetyInput))
"""The index of each input in `Health.inputs`."""


_OFF, _REQUIRED = Use.OFF, Use.REQUIRED
"""Global names, because each step reads them: `Use.OFF` takes six times as long in Python 3.11."""


def is_any_required(params: KernelParams) -> bool:
    """Return whether a safety input or a scan is required, so that its silence is a fault."""
    inputs = params.inputs
    return (
        params.scan.use is _REQUIRED
        or inputs.estop.use is _REQUIRED
        or inputs.joy.use is _REQUIRED
        or inputs.bumper.use is _REQUIRED
        or inputs.tilt.use is _REQUIRED
        or inputs.diagnostics.use is _REQUIRED
    )


def _used(health: Health, wanted: InputParams, place: int) -> Reading | None:
    """Return the last reading of an input, None if there is none or the input is off."""
    return health.inputs[place] if health.inputs and wanted.use is not _OFF else None


def estop_pressed(health: Health, params: KernelParams, t_ns: int) -> str:
    """Return a sentence if an emergency stop button is pressed or unreadable, else ""."""
    if not health.inputs:
        return ""
    for wanted, place in ((params.inputs.estop, _ESTOP), (params.inputs.joy, _JOY)):
        reading = _used(health, wanted, place)
        if reading is not None and reading.value != 0.0:
            return f"the emergency stop on {wanted.topic} {_pressed(reading)}"
    return ""


def bumper_pressed(health: Health, params: KernelParams, t_ns: int) -> str:
    """Return a sentence if the bumper is pressed or unreadable, else ""."""
    reading = _used(health, params.inputs.bumper, _BUMPER)
    if reading is None or reading.value == 0.0:
        return ""
    return f"the bumper on {params.inputs.bumper.topic} {_pressed(reading)}"


def _pressed(reading: Reading) -> str:
    return "cannot be read" if isnan(reading.value) else "is pressed"


def tilted(health: Health, params: KernelParams, t_ns: int) -> str:
    """Return a sentence if the robot is tilted too far, or its tilt is unknown, else ""."""
    wanted = params.inputs.tilt
    reading = _used(health, wanted, _TILT)
    if reading is None or reading.value <= wanted.max_rad:
        return ""
    if reading.value != reading.value:
        return f"{wanted.topic} holds no orientation"
    return f"the robot is tilted by {reading.value:.2f} rad, more than {wanted.max_rad:g} rad"


def base_fault(health: Health, params: KernelParams, t_ns: int) -> str:
    """Return a sentence if the diagnostics of the base report an error, else ""."""
    reading = _used(health, params.inputs.diagnostics, _DIAGNOSTICS)
    if reading is None or reading.value < LEVEL_OF_ERROR:
        return ""
    return f"diagnostics report an error: {reading.detail or 'without a text'}"


def estop_silent(health: Health, params: KernelParams, t_ns: int) -> str:
    """Return a sentence if a required emergency stop input is silent, else ""."""
    inputs = params.inputs
    return _unheard(inputs.estop, _ESTOP, health, t_ns) or _unheard(inputs.joy, _JOY, health, t_ns)


def input_lost(health: Health, params: KernelParams, t_ns: int) -> str:
    """Return a sentence if a required bumper, tilt or diagnostics input is silent, else ""."""
    inputs = params.inputs
    return (
        _unheard(inputs.bumper, _BUMPER, health, t_ns)
        or _unheard(inputs.tilt, _TILT, health, t_ns)
        or _unheard(inputs.diagnostics, _DIAGNOSTICS, health, t_ns)
    )


def _unheard(wanted: InputParams, place: int, health: Health, t_ns: int) -> str:
    if wanted.use is not _REQUIRED:
        return ""
    reading = health.inputs[place] if health.inputs else None
    if reading is None:
        return f"nothing was received on {wanted.topic} yet"
    age_s = abs(t_ns - reading.t_ns) / NS_PER_S
    return f"nothing on {wanted.topic} for {age_s:.2f} s" if age_s > wanted.timeout_s else ""


def obstacle_near(health: Health, params: KernelParams, t_ns: int) -> str:
    """Return a sentence if the scan shows an obstacle in the path or is unreadable, else ""."""
    scan = health.scan
    if scan is None or params.scan.use is _OFF:
        return ""
    if not scan.sectors:
        return f"a scan on {params.scan.topic} cannot be read"
    return f"something is {scan.ahead_m:.2f} m ahead of the robot" if scan.ahead_m < inf else ""


def scan_lost(health: Health, params: KernelParams, t_ns: int) -> str:
    """Return a sentence if a required scan is silent, else ""."""
    if params.scan.use is not _REQUIRED:
        return ""
    if health.scan is None:
        return f"no scan was received on {params.scan.topic} yet"
    age_s = abs(t_ns - health.scan.t_ns) / NS_PER_S
    too_old = age_s > params.scan.timeout_s
    return f"no scan on {params.scan.topic} for {age_s:.2f} s" if too_old else ""
