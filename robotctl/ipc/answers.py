"""The answers of the control socket: the stable keys of each method, with their types.

`daemon.api` builds these objects, and the commands read them. They cross the socket as JSON: a
value that is unknown or not finite is null.
"""

from __future__ import annotations

from typing import TypedDict

from robotctl.ipc.drive_answers import DriveAnswer as DriveAnswer
from robotctl.ipc.drive_answers import DriveFacts as DriveFacts
from robotctl.ipc.drive_answers import DrivenPath as DrivenPath
from robotctl.ipc.drive_answers import HoldAnswer as HoldAnswer
from robotctl.ipc.drive_answers import ModeAnswer as ModeAnswer


class Hello(TypedDict):
    """The first answer on each connection."""

    protocol: int
    version: str
    robot: str
    pid: int


class PoseAnswer(TypedDict):
    """A pose in the odometry frame [m, rad]."""

    x: float
    y: float
    theta: float


class VelocityAnswer(TypedDict):
    """A measured velocity [m/s, rad/s]."""

    linear: float
    angular: float


class RobotFacts(TypedDict):
    """The robot's part of `status`; None stands for an unknown value.

    For a daemon that only observes, each value is None.
    """

    mode: str | None
    phase: str | None
    mode_reason: str | None
    pose: PoseAnswer | None
    velocity: VelocityAnswer | None
    battery: float | None
    """From 0 to 1."""
    sim: bool | None
    lease: str | None
    """The holder of the lease, None if there is none."""
    stalls: int | None
    odometry_dropped: int | None
    drive: DriveFacts | None
    """The drive that is going on, None if there is none."""


class CountsAnswer(TypedDict):
    """What became of the received messages of a topic, or of all topics."""

    written: int
    queued: int
    dropped: int
    lost: int
    throttled: int


class TopicAnswer(CountsAnswer):
    """One recorded topic of one type."""

    name: str
    type: str
    count: int
    """Messages received."""
    rate: float
    """Messages per second."""
    bytes: int
    unseen: int


class RecorderAnswer(CountsAnswer):
    """The recorder's state and counts: received = written + queued + dropped."""

    state: str
    file: str
    bytes: int
    received: int


class RecordingFacts(TypedDict):
    """The recording's part of `status`."""

    topics: list[TopicAnswer]
    recorder: RecorderAnswer


class RecordStatus(RecordingFacts):
    """The answer of `record_status`."""

    warnings: list[str]


class Status(RobotFacts, RecordingFacts):
    """The answer of `status`: the stable keys of `robotctl status --json`."""

    robot: str
    version: str
    pid: int
    warnings: list[str]
    namespace: str
    """The robot's, empty for none."""
    domain_id: int
    discovery_range: str
    scheduling: str
    socket: str
    uptime_s: float


class ConditionAnswer(TypedDict):
    """One start condition; `problem` and `cure` are "" where it holds."""

    cause: str
    condition: str
    problem: str
    cure: str


class Preflight(TypedDict):
    """The answer of `preflight`: the most severe cause comes first."""

    passed: bool
    conditions: list[ConditionAnswer]


class StartSummary(TypedDict):
    """The object of `robotctl start --json`; a new daemon sends it on its pipe, not the socket."""

    ready: bool
    robot: str
    mode: str | None
    domain_id: int
    discovery_range: str
    sim: bool | None
    socket: str
    pid: int
    recording: str
    log: str
    notes: list[str]


class Stopped(TypedDict):
    """The answer of `stop`."""

    message: str


class LeaseAnswer(TypedDict):
    """The answer of `lease_release`, and of `lease_take` once the lease has ended."""

    message: str


class LeaseKept(TypedDict):
    """The answer of `lease_keep`."""

    yours: bool
    """Whether the token of the request holds the lease."""


class LeaseStatus(TypedDict):
    """The answer of `lease_status`; `holder` is None while everybody may start motion."""

    holder: str | None
    reason: str
    yours: bool
    """Whether the token of the request holds it."""


class Committed(TypedDict):
    """The answer of `record_commit`."""

    file: str
    uncommitted: int
    """Messages received before the request that the file does not hold yet."""
    failure: str
    """Why the recorder has failed, else ""."""


class FileSplit(TypedDict):
    """The answer of `record_split`."""

    message: str
    finished: str
    file: str


class Marked(TypedDict):
    """The answer of `mark`."""

    message: str
    text: str
    time_ns: int


class ParameterAnswer(TypedDict):
    """One parameter; `value` and `default` are as in a configuration file."""

    key: str
    value: bool | int | float | str | list[str]
    default: bool | int | float | str | list[str]
    type: str
    """boolean, whole number, number, text, or texts."""
    allowed: str
    changes: str
    """When it takes a new value."""
    about: str


class ParameterList(TypedDict):
    """The answer of `param_list`."""

    parameters: list[ParameterAnswer]


class ParameterSet(TypedDict):
    """The answer of `param_set`."""

    message: str
    key: str
    old: bool | int | float | str | list[str]
    new: bool | int | float | str | list[str]


class SimSet(TypedDict):
    """The answer of `sim_set`."""

    message: str


class SimFaulted(SimSet):
    """The answer of `sim_fault`, once the robot stopped or the fault is over."""

    mode: str
    stopped_after_ms: float | None
    """From the fault to the mode that commands zero, None if the robot was not stopped."""
