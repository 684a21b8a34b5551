"""The warnings that `robotctl status` and `/diagnostics` show, one sentence each.

To add one, yield it in `of_robot` or `of_recording`, or append its function to `Host.warnings`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator

from robotctl.base.domains import wider_discovery
from robotctl.daemon.control.dispatcher import Control
from robotctl.daemon.control.robot_report import is_connected
from robotctl.daemon.recording.flight_recorder import FlightRecorder
from robotctl.daemon.recording.recorder_report import NO_MEMORY
from robotctl.ipc.advice import for_robot
from robotctl.kernel.checks import FOREIGN_COMMAND_S, foreign_command
from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.params import Foreign
from robotctl.kernel.safety import RULE_OF
from robotctl.kernel.state import Health, is_level
from robotctl.kernel.types import Cause
from robotctl.recording import RecorderStats

PartWarning = Callable[[], str]
"""Returns a warning about a part of the daemon, or ""."""

RECENT_S = 600.0
"""How long `status` still shows a problem that is over."""

_CHECKS = tuple(
    RULE_OF[cause].check
    for cause in (
        Cause.NOT_ACTIVE,
        Cause.ESTOP_PRESSED,
        Cause.ESTOP_SILENT,
        Cause.FENCE_LEFT,
        Cause.OBSTACLE_NEAR,
        Cause.SCAN_LOST,
        Cause.BUMPER_PRESSED,
        Cause.TILTED,
        Cause.BASE_FAULT,
        Cause.INPUT_LOST,
        Cause.FOREIGN_PUBLISHER,
        Cause.SECOND_ODOMETRY,
        Cause.COMMAND_UNHEARD,
        Cause.COMMAND_TYPES_MIXED,
    )
)
"""Checks of start conditions that cause a warning even without a request for motion."""


class Warnings:
    """Collects the warnings of a daemon or, without `control`, of an observer."""

    def __init__(
        self,
        robot: str,
        recorder: FlightRecorder,
        control: Control | None,
        parts: Iterable[PartWarning],
        faults: Iterable[str] = (),
    ) -> None:
        self._robot = robot
        self._recorder = recorder
        self._control = control
        self._parts = parts
        self._faults = faults
        self._wider_discovery = wider_discovery()

    def now(self, stats: RecorderStats) -> list[str]:
        """Return all present warnings; `stats` is the recorder's counts."""
        return [for_robot(warning, self._robot) for warning in self._all(stats)]

    def of_recording(self, stats: RecorderStats) -> list[str]:
        """Return only the warnings about the recording; `stats` is the recorder's counts."""
        return [for_robot(warning, self._robot) for warning in of_recording(self._recorder, stats)]

    def _all(self, stats: RecorderStats) -> Iterator[str]:
        yield from of_recording(self._recorder, stats)
        if self._control is not None:
            yield from of_robot(self._control)
        yield from self._faults
        yield from filter(None, (part() for part in self._parts))
        if self._wider_discovery:
            yield f"ROS discovery is not limited to this machine: {self._wider_discovery}"


def of_recording(recorder: FlightRecorder, stats: RecorderStats) -> Iterator[str]:
    """Yield the warnings of the recorder."""
    yield from (text for text in (stats.failure, stats.warning) if text)
    if stats.no_memory:
        yield f"{stats.no_memory} messages {NO_MEMORY}"
    if stats.dropped > stats.no_memory and not stats.failure:
        worst = max(stats.topics, key=lambda topic: topic.dropped)
        yield (
            f"{stats.dropped} messages are not recorded, most of {worst.name}: "
            "they came faster than the disk writes, or are larger than the queue"
        )
    if stats.not_repeated:
        yield (
            f"{stats.not_repeated} latched messages are recorded once and not repeated in "
            "later files: they are larger than the room kept for that, or of too many publishers"
        )
    yield from recorder.problems()


def of_robot(control: Control) -> Iterator[str]:
    """Yield the warnings about the robot."""
    health, params, now_ns = control.state.health, control.params, time.monotonic_ns()
    yield from filter(None, (check(health, params, now_ns) for check in _CHECKS))
    if params.command.foreign is Foreign.WARN:
        yield from filter(None, [foreign_command(health, params, now_ns)])
    yield from _recent(health, now_ns)
    if health.odometry_fault:
        yield health.odometry_fault
    if health.odometry is not None and not is_connected(control):
        yield "odometry is older than its timeout"
    level, warn_level = health.battery_level, params.battery.warn_level
    if not params.battery.topic:
        yield "no battery topic is configured: the battery is not checked"
    elif is_level(level) and level < warn_level:
        yield f"the battery is at {level:.0%}, below {warn_level:.0%}: charge it soon"


def _recent(health: Health, now_ns: int) -> Iterator[str]:
    """Yield the problems that are over, but occurred in the last RECENT_S."""
    stalls, topic = health.stalls, health.command_topic
    age_s = (now_ns - stalls.last_t_ns) / NS_PER_S
    if stalls.count and age_s <= RECENT_S:
        yield (
            f"stalls of the control loop: {stalls.count}, the last {age_s:.0f} s ago for "
            f"{stalls.last_s:.2f} s ({stalls.detail}); zeros were sent meanwhile"
        )
    if topic.foreign_t_ns is not None:
        age_s = (now_ns - topic.foreign_t_ns) / NS_PER_S
        if FOREIGN_COMMAND_S < age_s <= RECENT_S and not health.foreign_publishers:
            yield f"{topic.foreign_by} published a velocity command {age_s:.0f} s ago"
