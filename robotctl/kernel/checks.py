"""The checks of `safety.RULES`."""

from __future__ import annotations

from collections.abc import Callable
from math import inf, isfinite, isnan

from robotctl.kernel.constants import COMMAND_TYPES, NS_PER_S, TWIST, TWIST_STAMPED
from robotctl.kernel.fence import left_by
from robotctl.kernel.params import Foreign, KernelParams, Stamping
from robotctl.kernel.safety_inputs import InputParams, Reading, SafetyInput, Use
from robotctl.kernel.state import Health, is_level
from robotctl.kernel.types import Cause, LifecycleState

FOREIGN_COMMAND_S = 1.0
"""The time [s] for which a command of another node forbids motion."""


def _age_s(then_ns: int, t_ns: int) -> float:
    """Return the absolute difference of two times [s]."""
    return abs(t_ns - then_ns) / NS_PER_S  # data from the future is stale, too


Check = Callable[[Health, KernelParams, int], str]
"""Returns a sentence if the health shows a fault at a steady time [ns], else ""."""


# Each check runs at each tick: it returns early if its input is off.


def healthy(health: Health, params: KernelParams, t_ns: int) -> str:
    """Return "", as the check of a cause that is not measured: an event or a request raises it."""
    return ""


def reported(cause: Cause) -> Check:
    """Return the check that gives a sentence while the daemon reports the failure `cause`."""

    def check(health: Health, params: KernelParams, t_ns: int) -> str:
        for reported, detail in health.reported:
            if reported is cause:
                return detail or cause.value
        return ""

    return check


def not_active(health: Health, params: KernelParams, t_ns: int) -> str:
    """Return a sentence if the lifecycle node `mode_service` is not active, else ""."""
    if health.lifecycle is LifecycleState.ACTIVE:
        return ""
    return f"mode_service is {health.lifecycle.value}, not active"


def battery_at_stop(health: Health, params: KernelParams, t_ns: int) -> str:
    """Return a sentence if the battery is at or below its stop level, else ""."""
    level, stop_level = health.battery_level, params.battery.stop_level
    if not params.battery.topic or not is_level(level) or level > stop_level:
        return ""
    return f"the battery is at {_shown(level)}, at or below {stop_level:.0%}"


def battery_before_clear(health: Health, params: KernelParams, t_ns: int) -> str:
    """Return a sentence if the battery level is below the clear level or unknown, else ""."""
    level, clear_level = health.battery_level, params.battery.clear_level
    if not params.battery.topic or (is_level(level) and level >= clear_level):
        return ""
    return f"the battery is at {_shown(level)}, not yet at {clear_level:.0%}"


def _shown(level: float | None) -> str:
    return f"{level:.0%}" if is_level(level) else "an unknown level"


def battery_unknown(health: Health, params: KernelParams, t_ns: int) -> str:
    """Return a sentence if the battery level is unknown, impossible or too old, else ""."""
    if not params.battery.topic:
        return ""
    if health.battery_level is None:
        return f"no battery level was received on {params.battery.topic} yet"
    if not is_level(health.battery_level):
        full, reported = (100, 100.0) if health.battery_in_percent else (1, 1.0)
        return f"the battery reports {health.battery_level * reported:g}, not 0 to {full}"
    age_s = _age_s(health.battery_t_ns, t_ns)
    return f"no battery level for {age_s:.1f} s" if age_s > params.battery.timeout_s else ""


def odometry_wrong(health: Health, params: KernelParams, t_ns: int) -> str:
    """Return a sentence if odometry has a wrong frame, or is lost after a bad sample, else ""."""
    wanted, sources = params.odometry.frame_id, health.odometry_sources
    if wanted:
        for source, found in sources.frames:
            if source == sources.followed and found != wanted:
                return f"odometry is in the frame {found}, not in {wanted} (odometry.frame_id)"
    if not health.odometry_fault or not odometry_lost(health, params, t_ns):
        return ""
    return health.odometry_fault


def odometry_lost(health: Health, params: KernelParams, t_ns: int) -> str:
    """Return a sentence if there is no odometry or the last usable sample is too old, else ""."""
    if health.odometry is None:
        return f"no odometry was received on {params.odometry.topic} yet"
    age_s = _age_s(health.odometry_t_ns, t_ns)
    if age_s <= params.odometry.timeout_s:
        return ""
    return f"no odometry on {params.odometry.topic} for {age_s:.2f} s"


def odometry_contradicted(health: Health, params: KernelParams, t_ns: int) -> str:
    """Return a sentence if the poses of two odometry publishers contradict each other, else ""."""
    second, limits = health.odometry_sources.second, params.odometry
    if second is None or _age_s(second.t_ns, t_ns) > limits.timeout_s:
        return ""
    if second.distance_m <= limits.max_jump_m and second.angle_rad <= limits.max_jump_rad:
        return ""
    apart = f"{second.distance_m:.2f} m and {second.angle_rad:.2f} rad apart"
    if not isfinite(second.distance_m + second.angle_rad):
        apart = "not both finite"
    return f"{_two_sources(health)}, and they are {apart}"


def second_odometry(health: Health, params: KernelParams, t_ns: int) -> str:
    """Return a sentence if a second publisher sends odometry, else ""."""
    second = health.odometry_sources.second
    if second is None or _age_s(second.t_ns, t_ns) > params.odometry.timeout_s:
        return ""
    return _two_sources(health)


def _two_sources(health: Health) -> str:
    sources = health.odometry_sources
    assert sources.second is not None
    names = sources.name_of(sources.followed), sources.name_of(sources.second.source)
    return f"odometry comes from two publishers, {names[0]} and {names[1]}"


def tracking_lost(health: Health, params: KernelParams, t_ns: int) -> str:
    """Return a sentence if the robot is too far from the reference of its drive, else ""."""
    error_m, limit_m = health.path_error_m, params.tracking.max_error_m
    if error_m <= limit_m:
        return ""
    if error_m == inf:
        return "the robot is further from where it should be than the pattern is large"
    return f"the robot is {error_m:.2f} m from where it should be, more than {limit_m:g} m"


def fence_left(health: Health, params: KernelParams, t_ns: int) -> str:
    """Return a sentence if the robot is outside its fence, else ""."""
    fence = params.fence
    if not (fence.radius_m or fence.corners_m):
        return ""
    if health.fence_origin is None or health.odometry is None:
        return ""
    return left_by(fence, health.fence_origin, health.odometry.pose)


def foreign_publisher(health: Health, params: KernelParams, t_ns: int) -> str:
    """Return "" if `command.foreign` is WARN, else the result of `foreign_command`."""
    return "" if params.command.foreign is Foreign.WARN else foreign_command(health, params, t_ns)


def foreign_command(health: Health, params: KernelParams, t_ns: int) -> str:
    """Return a sentence if another node sends commands or has a publisher for them, else "".

    A silent publisher counts unless `command.foreign` is YIELD.
    """
    if health.foreign_publishers and params.command.foreign is not Foreign.YIELD:
        names = ", ".join(health.foreign_publishers)
        verb = "publishes" if len(health.foreign_publishers) == 1 else "publish"
        return f"{names} also {verb} velocity commands"
    topic = health.command_topic
    if topic.foreign_t_ns is None or _age_s(topic.foreign_t_ns, t_ns) > FOREIGN_COMMAND_S:
        return ""
    return f"{topic.foreign_by} also published a velocity command"


def command_unheard(health: Health, params: KernelParams, t_ns: int) -> str:
    """Return a sentence if no subscription has the topic and type of the command, else ""."""
    topic = health.command_topic
    if topic.listeners is None or topic.listeners > 0:
        return ""
    if not topic.other_types:
        return f"no node subscribes to {params.command.topic}"
    types = ", ".join(topic.other_types)
    return f"the robot takes {types} on {params.command.topic}, not {topic.type_name}"


def command_types_mixed(health: Health, params: KernelParams, t_ns: int) -> str:
    """Return a sentence if `stamped` is AUTO and there are subscribers of both types, else ""."""
    topic = health.command_topic
    taken = COMMAND_TYPES.intersection((topic.type_name, *topic.other_types))
    if params.command.stamped is not Stamping.AUTO or not topic.listeners or len(taken) < 2:
        return ""
    return f"some nodes take {TWIST} on {params.command.topic}, others {TWIST_STAMPED}"


def tick_overrun(health: Health, params: KernelParams, t_ns: int) -> str:
    """Return a sentence if the time since the last tick is too long or negative, else ""."""
    gap_s = health.tick_gap_s
    if gap_s < 0.0:
        return f"the steady clock went back by {-gap_s:.2f} s"
    return f"no control tick for {gap_s:.2f} s" if gap_s > 0.0 else ""


LEVEL_OF_ERROR = 2.0

_ESTOP, _JOY, _BUMPER, _TILT, _DIAGNOSTICS = range(len(SafetyInput))
"""The index of each input in `Health.inputs`."""


# Each step reads these: `Use.OFF` is a slow lookup in Python 3.11.
_OFF, _REQUIRED = Use.OFF, Use.REQUIRED


def is_any_required(params: KernelParams) -> bool:
    """Return whether a safety input or the scan is required."""
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
    """Return a sentence if the diagnostics report an error or are unreadable, else ""."""
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
