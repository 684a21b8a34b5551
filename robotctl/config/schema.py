"""What a configuration may set, with defaults and ranges."""

from __future__ import annotations

from dataclasses import dataclass, field

from robotctl.kernel.params import KernelParams
from robotctl.kernel.ranges import Change, bounded, setting
from robotctl.recording.format.compression import Compression
from robotctl.sim.robot import SimParams


@dataclass(frozen=True, slots=True)
class RecordingParams:
    """What is recorded, and how long recordings are kept.

    `compression` is zstd, lz4 or none. The oldest recordings are removed until at most
    `max_total_gb` are left and none is older than `max_age_days`; 0 means no limit. A topic is
    recorded if a pattern of `include` matches it, or `include` is empty, and no pattern of
    `exclude` matches it. `throttle` and `expected_rates` give rates [1/s] to patterns, each as
    PATTERN=RATE; the first pattern that matches counts. A clip is cut around each emergency stop
    and error, from `clip_before_s` before it to `clip_after_s` after it; with `clip_before_s` 0 no
    clips are cut. `group_readable` lets the group read the recordings, otherwise only their owner
    may. `seal` signs them with a key of the robot; `publish_heads` publishes the newest head on a
    topic, and `head_command` is run with it.
    """

    compression: Compression = setting(Compression.ZSTD, "compression of the chunks", Change.START)
    max_total_gb: float = bounded(20.0, 0.0, 1e6, "GB", "size of all recordings that are kept")
    max_age_days: float = bounded(
        30.0, 0.0, 1e5, "days", "age of the oldest recording that is kept"
    )
    include: tuple[str, ...] = setting((), "topics that are recorded", Change.START)
    exclude: tuple[str, ...] = setting((), "topics that are not recorded", Change.START)
    clip_before_s: float = bounded(
        30.0, 0.0, 3600.0, "s", "what a clip holds before its event; 0: no clips"
    )
    clip_after_s: float = bounded(5.0, 0.0, 600.0, "s", "what a clip holds after its event")
    throttle: tuple[str, ...] = setting(
        (), "messages a second that are recorded at most, by topic", Change.START, rates=True
    )
    expected_rates: tuple[str, ...] = setting(
        (),
        "messages a second that are expected, by topic; 0: no expectation",
        Change.START,
        rates=True,
    )
    min_free_gb: float = bounded(
        0.0,
        0.0,
        1e6,
        "GB",
        "with less free on the disk, the heaviest topics are not recorded; 0: off",
        Change.START,
    )
    index: bool = setting(True, "index a closed recording; needs robotctl[parquet]")
    group_readable: bool = setting(False, "the group may read (0640, 0750)", Change.START)
    foxglove_events: bool = setting(
        False, "changes of the mode and marks are recorded as events of Foxglove", Change.START
    )
    seal: bool = setting(True, "sign the recordings with the robot's key", Change.START)
    publish_heads: bool = setting(
        False, "publish the newest head of the seal on robotctl/head", Change.START
    )
    head_command: str = setting(
        "", "program that gets each new head of the seal as an argument", Change.START, command=True
    )


@dataclass(frozen=True, slots=True)
class DecisionParams:
    """How long the journal of decisions is kept; 0 means forever."""

    keep_years: float = bounded(
        5.0, 0.0, 100.0, "years", "how long the journal of decisions is kept", Change.START
    )


@dataclass(frozen=True, slots=True)
class SocketParams:
    """Who may give commands on the control socket besides its owner and root."""

    group: str = setting(
        "", "Unix group whose members may give every command (0660, 0750)", Change.START, group=True
    )


@dataclass(frozen=True, slots=True)
class Config:
    """Every setting. In a file, the kernel's parameters have no prefix.

    `fifo_priority` is the SCHED_FIFO priority of the loop's thread, from 1 (low) to 99; 0 leaves
    the scheduling as it is. `on_recorder_failure` is stop or warn: whether the robot must stop
    when recording fails. `on_topic_trouble` is warn or refuse: whether a topic of others that is
    not as expected refuses the start of a motion.
    """

    kernel: KernelParams = field(default_factory=KernelParams)
    sim: SimParams = field(default_factory=SimParams)
    recording: RecordingParams = field(default_factory=RecordingParams)
    decisions: DecisionParams = field(default_factory=DecisionParams)
    socket: SocketParams = field(default_factory=SocketParams)
    fifo_priority: int = bounded(
        0, 0, 99, about="SCHED_FIFO priority of the loop's thread", change=Change.START
    )
    autostart: bool = setting(True, "mode_service configures and activates itself", Change.START)
    on_recorder_failure: str = setting(
        "stop", "what a failed recorder does", choices=("stop", "warn")
    )
    on_topic_trouble: str = setting(
        "warn",
        "what a topic that is silent, slow or fast does to the start of a motion",
        Change.START,
        choices=("warn", "refuse"),
    )
