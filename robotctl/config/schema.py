"""What a configuration may set, with defaults and ranges."""

from __future__ import annotations

from dataclasses import dataclass, field

from robotctl.kernel.params import KernelParams
from robotctl.kernel.ranges import bounded
from robotctl.recording.format.compression import Compression
from robotctl.sim.robot import SimParams


@dataclass(frozen=True, slots=True)
class RecordingParams:
    """What is recorded, and how long recordings are kept.

    `compression` is zstd or none. The oldest recordings are removed until at most `max_total_gb`
    are left and none is older than `max_age_days`; 0 means no limit. A topic is recorded if a
    pattern of `include` matches it, or `include` is empty, and no pattern of `exclude` matches it.
    A clip is cut around each emergency stop and error, from `clip_before_s` before it to
    `clip_after_s` after it; with `clip_before_s` 0 no clips are cut. `group_readable` lets the
    group read the recordings, otherwise only their owner may.
    """

    compression: Compression = Compression.ZSTD
    max_total_gb: float = bounded(20.0, 0.0, 1e6, "GB")
    max_age_days: float = bounded(30.0, 0.0, 1e5, "days")
    include: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    clip_before_s: float = bounded(30.0, 0.0, 3600.0, "s")
    clip_after_s: float = bounded(5.0, 0.0, 600.0, "s")
    group_readable: bool = False


@dataclass(frozen=True, slots=True)
class Config:
    """Every setting. In a file, the kernel's parameters have no prefix.

    `fifo_priority` is the SCHED_FIFO priority of the loop's thread, from 1 (low) to 99; 0 leaves
    the scheduling as it is. `on_recorder_failure` is stop or warn: whether the robot must stop
    when recording fails.
    """

    kernel: KernelParams = field(default_factory=KernelParams)
    sim: SimParams = field(default_factory=SimParams)
    recording: RecordingParams = field(default_factory=RecordingParams)
    fifo_priority: int = bounded(0, 0, 99)
    on_recorder_failure: str = field(default="stop", metadata={"choices": ("stop", "warn")})
