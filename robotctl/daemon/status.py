"""What `robotctl status` tells: the stable keys, gathered from every part."""

from __future__ import annotations

import os
import time
from typing import Any

from robotctl import __version__
from robotctl.daemon.control import Control
from robotctl.daemon.options import DaemonOptions
from robotctl.daemon.statistics import RateMeter
from robotctl.kernel.geometry import Pose
from robotctl.kernel.params import KernelParams
from robotctl.paths import socket_path
from robotctl.recording.recorder import Recorder
from robotctl.ros.tap import Tap

MAX_DRIVEN_POSES = 20_000
"""Of the driven path; beyond it every second pose is forgotten."""

MIN_STEP_M = 0.005
"""Poses nearer to the one before are not kept."""


class StatusSource:
    """Gathers the status; `sim` says whether the robot is simulated.

    `scheduling` is how the kernel schedules the loop's thread.
    """

    def __init__(
        self,
        options: DaemonOptions,
        control: Control,
        recorder: Recorder,
        tap: Tap,
        params: KernelParams,
        scheduling: str,
    ) -> None:
        self.sim = False
        self._options = options
        self._control = control
        self._recorder = recorder
        self._tap = tap
        self._params = params
        self._scheduling = scheduling
        self._rates = RateMeter()
        self._started = time.monotonic()
        self._driven: list[Pose] = []
        self._wanted: list[Pose] = []
        self._drive_id: int | None = None

    def sample(self) -> None:
        """Take the counts that rates are made of; once a second."""
        counts = ((topic.name, topic.received) for topic in self._recorder.stats().topics)
        self._rates.sample(time.monotonic_ns(), counts)

    def drove_to(self, pose: Pose) -> None:
        """Note a pose of the present drive."""
        drive = self._control.state.drive
        assert drive is not None
        if drive.request_id != self._drive_id:
            self._drive_id = drive.request_id
            self._driven = [drive.origin]
            self._wanted = [drive.origin.compose(pose) for pose in drive.path.outline()]
        if self._driven[-1].distance(pose) >= MIN_STEP_M:
            self._driven.append(pose)
            if len(self._driven) > MAX_DRIVEN_POSES:
                del self._driven[1::2]

    def path(self) -> dict[str, Any]:
        """Return the wanted and the driven path of the present or last drive [m, odom frame]."""
        return {
            "reference": [[pose.x, pose.y] for pose in self._wanted],
            "driven": [[pose.x, pose.y] for pose in self._driven],
        }

    def is_connected(self) -> bool:
        """Say whether odometry is fresher than its timeout."""
        health = self._control.state.health
        if health.odometry is None:
            return False
        age_s = (time.monotonic_ns() - health.odometry_t_ns) / 1e9
        return age_s <= self._params.odometry.timeout_s

    def status(self) -> dict[str, Any]:
        """Return the object of `robotctl status --json`."""
        state = self._control.state
        odometry = state.health.odometry
        recorder = self._recorder.stats()
        level = state.health.battery_level
        return {
            "robot": self._options.robot,
            "version": __version__,
            "pid": os.getpid(),
            "mode": state.mode.name,
            "phase": state.phase.value,
            "mode_reason": state.reason,
            "pose": None
            if odometry is None
            else {"x": odometry.pose.x, "y": odometry.pose.y, "theta": odometry.pose.theta},
            "velocity": None
            if odometry is None
            else {"linear": odometry.velocity.linear, "angular": odometry.velocity.angular},
            "battery": None if level is None or level != level else level,
            "sim": self.sim,
            "topics": [
                {
                    "name": topic.name,
                    "type": topic.type_name,
                    "count": topic.received,
                    "rate": self._rates.rate(topic.name),
                }
                for topic in sorted(recorder.topics, key=lambda topic: topic.name)
            ],
            "recorder": {
                "state": recorder.state.value,
                "file": str(recorder.file),
                "bytes": recorder.bytes,
                "received": recorder.received,
                "written": recorder.written,
                "queued": recorder.queued,
                "dropped": recorder.dropped,
                "lost": recorder.lost,
            },
            "warnings": list(self._warnings(recorder.failure, recorder.warning)),
            "domain_id": self._options.domain_id,
            "discovery_range": discovery_range(),
            "scheduling": self._scheduling,
            "socket": str(socket_path(self._options.robot)),
            "uptime_s": round(time.monotonic() - self._started, 3),
        }

    def _warnings(self, *recorder: str) -> list[str]:
        health = self._control.state.health
        warnings = [text for text in recorder if text]
        warnings += self._tap.problems.values()
        if health.foreign_publishers:
            names = ", ".join(health.foreign_publishers)
            warnings.append(f"{names} also publishes velocity commands")
        if health.odometry_fault:
            warnings.append(health.odometry_fault)
        if health.odometry is not None and not self.is_connected():
            warnings.append("odometry is older than its timeout")
        if not self._params.battery.topic:
            warnings.append("no battery topic is configured: the battery is not checked")
        if discovery_range() not in ("LOCALHOST", "OFF"):
            warnings.append("ROS discovery is not limited to this machine")
        return warnings


def discovery_range() -> str:
    """Return how far ROS looks for others, as its environment variable has it."""
    return os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
