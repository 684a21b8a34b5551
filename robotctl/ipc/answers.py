"""The answers of the control socket: the stable keys of each method, with their types.

`daemon.api` builds these objects, and the commands read them. They cross the socket as JSON: a
value that is unknown or not finite is null.
"""

from __future__ import annotations

from typing import TypedDict


class DriveFacts(TypedDict):
    """The drive that is going on, and its errors so far: of `kernel.types.DriveReport`."""

    what: str
    lap: int
    laps: int
    """0: until stopped."""
    distance_m: float
    duration_s: float
    cross_track_m: float | None
    """None where nothing is measured, as are the other errors: a velocity has no path."""
    cross_track_rms_m: float | None
    cross_track_max_m: float | None
    true_cross_track_rms_m: float | None
    """By the true pose of a robot that the daemon simulates; None for any other."""
    true_cross_track_max_m: float | None
    true_heading_rms_rad: float | None
    true_heading_max_rad: float | None
    true_closure_m: float | None
    heading_rms_rad: float | None
    heading_max_rad: float | None
    closure_m: float | None
    """At the end of the last lap; None before the first is complete."""


class DrivenPath(TypedDict):
    """The answer of `path`: points of the present or last drive, in the odometry frame [m]."""

    reference: list[list[float]]
    driven: list[list[float]]


class ModeAnswer(TypedDict):
    """The answer of `set_mode`, `reset`, `end_drive`, and of a `drive` that is not waited for."""

    message: str
    mode: str


class DriveAnswer(ModeAnswer, total=False):
    """The answer of `drive`; the figures are there when the call waited for the end of the drive.

    They are those of `kernel.types.DriveReport`; None stands for an unknown value.
    """

    laps: int
    distance_m: float | None
    cross_track_rms_m: float | None
    cross_track_max_m: float | None
    true_cross_track_rms_m: float | None
    true_cross_track_max_m: float | None
    true_heading_rms_rad: float | None
    true_heading_max_rad: float | None
    true_closure_m: float | None
    closure_m: float | None
    heading_rms_rad: float | None
    heading_max_rad: float | None
    duration_s: float | None


class HoldAnswer(ModeAnswer):
    """The answer of `hold`; a hold that is over has the `hold` 0, and `message` says why."""

    hold: int


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


class NameAndTypes(TypedDict):
    """A topic or a service: its full name, and its types, which should be one."""

    name: str
    types: list[str]


class Graph(TypedDict):
    """The names that the daemon sees on ROS; `left_out` says how many more there are."""

    topics: list[NameAndTypes]
    services: list[NameAndTypes]
    nodes: list[str]
    left_out: int


class GraphEndpoint(TypedDict):
    """A publisher or a subscription; `node` is "" while it is unknown.

    `qos` has reliability, durability, history and depth; "unknown" is what DDS does not tell.
    """

    node: str
    type: str
    gid: str
    qos: dict[str, str | int]


class GraphTopic(TypedDict):
    """A topic with all that publish it or subscribe to it; both are empty for an unknown one."""

    name: str
    types: list[str]
    publishers: list[GraphEndpoint]
    subscriptions: list[GraphEndpoint]


class GraphNode(TypedDict):
    """What a node publishes, subscribes to, serves and calls."""

    name: str
    publishers: list[NameAndTypes]
    subscriptions: list[NameAndTypes]
    servers: list[NameAndTypes]
    clients: list[NameAndTypes]
