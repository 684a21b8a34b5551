"""Checks for `safety.RULES`, except those in `input_checks`: each returns what is wrong, or ""."""

from __future__ import annotations

from collections.abc import Callable
from math import inf, isfinite

from robotctl.kernel.command_types import COMMAND_TYPES, TWIST, TWIST_STAMPED
from robotctl.kernel.fence import left_by
from robotctl.kernel.params import Foreign, KernelParams, Stamping
from robotctl.kernel.state import Health, is_level
from robotctl.kernel.types import Cause
from robotctl.kernel.types.events import LifecycleState
from robotctl.kernel.units import NS_PER_S

FOREIGN_COMMAND_S = 1.0
"""For how long one command of another node prevents motion, as that node may send rarely."""


def _age_s(then_ns: int, t_ns: int) -> float:
    """Return the time from `then_ns` to `t_ns` [s], without its sign: the future is stale, too."""
    return abs(t_ns - then_ns) / NS_PER_S


Check = Callable[[Health, KernelParams, int], str]
"""Checks the health at a steady time [ns] and returns what is wrong, "" if nothing is."""


def healthy(health: Health, params: KernelParams, t_ns: int) -> str:
    """Return "" always: this check is for the causes that an event or a request raises."""
    return ""


def reported(cause: Cause) -> Check:
    """Return the check that finds `cause` among the faults that the daemon reported."""

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
    """Return a sentence if the received odometry is unusable, else "".

    A wrong frame (`odometry.frame_id`) counts at once, a fault when no usable sample is recent.
    """
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
    """Return a sentence if two nodes publish odometry at present, else ""."""
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
    """Return the sentence of `foreign_command`, or "" if `command.foreign` is WARN."""
    return "" if params.command.foreign is Foreign.WARN else foreign_command(health, params, t_ns)


def foreign_command(health: Health, params: KernelParams, t_ns: int) -> str:
    """Return a sentence if another node sends commands or (unless YIELD) has a publisher."""
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
    """Return a sentence if `stamped` is AUTO and nodes subscribe to both types, else ""."""
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
