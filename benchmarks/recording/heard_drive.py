"""A recording of a simulated drive with every topic that a check compares, made without ROS."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from pathlib import Path

from robotctl.check.closed_loop import closed_loop
from robotctl.config import Config, with_setting
from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.types import Effect, Event
from robotctl.messages.cdr import ENCAPSULATION
from robotctl.recording import Compression, Recorder, RecorderOptions
from robotctl.recording.seal import Keyring
from robotctl.testing.drives import (
    BEGIN_NS,
    GID,
    ODOMETRY,
    START_NS,
    drive_requested,
    installed_topic,
    journaled,
    record,
)
from robotctl.testing.hearing import BATTERY, HearingKernel

SNAPSHOT_PERIOD_S = 10.0
"""The period in which a daemon writes a snapshot."""

CHUNK_BYTES = 35_000
"""About the amount that a daemon at 100 Hz commits each 250 ms."""

_TOPICS = {
    ODOMETRY.name: ODOMETRY,
    BATTERY: installed_topic(BATTERY, "sensor_msgs/msg/BatteryState"),
}
_STATUS = installed_topic("/robot_status", "robot_controller/msg/RobotStatus")
_STATUS_PERIOD_NS = NS_PER_S


class _Listener:
    """Records what the kernel received, and its status each second and at each change of mode.

    `record` calls it before each item of the journal.
    """

    def __init__(self, kernel: HearingKernel) -> None:
        self._kernel = kernel
        self._mode = kernel.state.mode
        self._due_ns = START_NS + BEGIN_NS + _STATUS_PERIOD_NS
        self._shown = 0
        self._has_begun = False

    def __call__(self, recorder: Recorder, time_ns: int) -> None:
        if not self._has_begun:  # the first snapshot comes before everything else
            self._has_begun = True
            return
        heard = self._kernel.messages
        for (topic, sequence), data in heard.items():
            channel = recorder.add_topic(_TOPICS[topic])
            recorder.write(channel, data, time_ns, time_ns, sequence, GID)
        heard.clear()
        state, event = self._kernel.state, self._kernel.heard
        is_written = event is not None and time_ns > START_NS + event.t_ns
        if is_written and (time_ns >= self._due_ns or state.mode is not self._mode):
            self._mode = state.mode
            self._due_ns = time_ns + _STATUS_PERIOD_NS
            self._shown += 1
            channel = recorder.add_topic(_STATUS)
            recorder.write(channel, self._status(), time_ns, time_ns, self._shown, GID)

    def _status(self) -> bytes:
        state = self._kernel.state
        level = state.health.battery_level
        head = struct.pack("<4sI6sB", ENCAPSULATION, 6, b"robot\0", state.mode)
        head += bytes(-len(head) % 4)
        shown = float("nan") if level is None else level
        return head + struct.pack("<ff?", shown, 40.0, state.health.odometry is not None)


def record_drive(
    folder: Path,
    seconds: float,
    *,
    rate_hz: float,
    moving: bool,
    compression: Compression = Compression.ZSTD,
) -> Path:
    """Record a drive, or a robot that stands, in one sealed file; return its folder."""
    config = with_setting(Config(), "rate_hz", rate_hz)
    config = with_setting(config, "sim.odometry_rate_hz", rate_hz)
    kernel = HearingKernel(config)
    keys = folder.with_name(f"{folder.name} keys")
    keys.mkdir(mode=0o700)
    options = RecorderOptions(
        compression=compression,
        chunk_bytes=CHUNK_BYTES,
        split_bytes=1 << 40,
        split_s=1e9,
        sealer=Keyring(keys, "robot"),
    )
    requests = [drive_requested()] if moving else []
    snapshots_ns = range(
        BEGIN_NS, BEGIN_NS + round(seconds * NS_PER_S), round(SNAPSHOT_PERIOD_S * NS_PER_S)
    )
    written = journaled(kernel, _heard(kernel, config, seconds, requests), snapshots_ns)
    return record(folder, written, config=config, options=options, beside=_Listener(kernel))


def _heard(
    kernel: HearingKernel, config: Config, seconds: float, requests: Iterable[Event]
) -> Iterator[tuple[Event, tuple[Effect, ...]]]:
    end_ns = BEGIN_NS + round(seconds * NS_PER_S)
    for _, effects in closed_loop(kernel, config.sim, requests, BEGIN_NS):
        assert kernel.heard is not None
        yield kernel.heard, effects
        if kernel.heard.t_ns >= end_ns and effects:
            return
