"""The answers of the control socket, with the stable keys and types of each method's answer.

In JSON, a value that is unknown or not finite is null.
"""

from __future__ import annotations

from typing import TypedDict


class DriveFigures(TypedDict, total=False):
    """The errors of a drive. None means unknown, or a drive without a path, such as `hold`."""

    laps: int
    distance_m: float | None
    duration_s: float | None
    cross_track_rms_m: float | None
    cross_track_max_m: float | None
    heading_rms_rad: float | None
    heading_max_rad: float | None
    closure_m: float | None
    """The distance between the ends of the last complete lap and of the path, None before a lap."""
    true_cross_track_rms_m: float | None
    """The `true_*` fields use a simulated robot's true pose. None for a real robot."""
    true_cross_track_max_m: float | None
    true_heading_rms_rad: float | None
    true_heading_max_rad: float | None
    true_closure_m: float | None


class DriveFacts(DriveFigures):
    """The current drive and its errors so far, as in `kernel.types.DriveReport`.

    `laps` is the number of laps to drive, or 0 for a drive until stopped.
    """

    what: str
    lap: int
    cross_track_m: float | None


class DrivenPath(TypedDict):
    """The answer to `path`: wanted and driven points of the newest drive, in the odom frame [m]."""

    reference: list[list[float]]
    driven: list[list[float]]


class MessageAnswer(TypedDict):
    """The answer of `stop`, `sim_set`, `lease_release` and, when the lease ends, `lease_take`."""

    message: str


class ModeAnswer(MessageAnswer):
    """The answer of `set_mode`, `reset` and `end_drive`, and the base class of other answers."""

    mode: str


class DriveAnswer(ModeAnswer, DriveFigures):
    """The answer of `drive`, `drive_path` and `drive_velocity`. Only `wait` adds DriveFigures."""


class HoldAnswer(ModeAnswer):
    """The answer of `hold`. From the second request on, `message` is why the mode last changed."""

    hold: int
    """The number of the held motion, for the next request, or 0 if the motion has ended."""


class Hello(TypedDict):
    """The answer of `hello`, the first request on each connection."""

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
    """The robot's part of `status`. None means unknown. With `--observe`, every field is None."""

    mode: str | None
    phase: str | None
    mode_reason: str | None
    pose: PoseAnswer | None
    velocity: VelocityAnswer | None
    battery: float | None
    """From 0 to 1."""
    sim: bool | None
    lease: str | None
    """The holder of the lease, or None."""
    stalls: int | None
    odometry_dropped: int | None
    drive: DriveFacts | None
    """The current drive, or None."""


class CountsAnswer(TypedDict):
    """Counts of messages, as in `recording.format.topics.MessageCounts`."""

    written: int
    queued: int
    dropped: int
    lost: int
    throttled: int


class TopicAnswer(CountsAnswer):
    """The counts of one topic with one type. A topic with two types is listed twice."""

    name: str
    type: str
    count: int
    """Messages received."""
    rate: float
    """Received messages per second."""
    bytes: int
    unseen: int


class RecorderAnswer(CountsAnswer):
    """The recorder's state, and the message counts of all topics."""

    state: str
    file: str
    bytes: int
    received: int


class RecordingFacts(TypedDict):
    """The fields of `status` about the recording."""

    topics: list[TopicAnswer]
    recorder: RecorderAnswer


class RecordStatus(RecordingFacts):
    """The answer of `record_status`: topics, recorder, and warnings about the recording."""

    warnings: list[str]


class Status(RobotFacts, RecordingFacts):
    """The answer of `status`: the stable keys of `robotctl status --json`."""

    robot: str
    version: str
    pid: int
    warnings: list[str]
    namespace: str
    """The ROS namespace of the robot, "" if it has none."""
    domain_id: int
    discovery_range: str
    scheduling: str
    socket: str
    uptime_s: float


class ConditionAnswer(TypedDict):
    """One start condition. `problem` and `cure` are "" if the condition is met."""

    cause: str
    condition: str
    problem: str
    cure: str


class Preflight(TypedDict):
    """The answer of `preflight`: the start conditions, the most severe cause first."""

    passed: bool
    conditions: list[ConditionAnswer]


class StartSummary(TypedDict):
    """The object of `robotctl start --json`."""

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


class LeaseKept(TypedDict):
    """The answer of `lease_keep`, the request with which a client keeps its lease."""

    yours: bool
    """Whether the token in the request is that of the lease."""


class LeaseStatus(LeaseKept):
    """The answer of `lease_status`. If `holder` is None, every client may start motion."""

    holder: str | None
    reason: str


class Committed(TypedDict):
    """The answer of `record_commit`: whether the file has all messages received before it."""

    file: str
    uncommitted: int
    """The number of messages from before the request that are not in the file yet."""
    failure: str
    """The reason for the recorder's failure, or ""."""


class FileSplit(MessageAnswer):
    """The answer of `record_split`: the finished file, and the file that follows it."""

    finished: str
    file: str


class Marked(MessageAnswer):
    """The answer of `mark`: the text of the mark, and its time in the recording."""

    text: str
    time_ns: int


class ParameterAnswer(TypedDict):
    """One parameter, with `value` and `default` as in a configuration file."""

    key: str
    value: bool | int | float | str | list[str]
    default: bool | int | float | str | list[str]
    type: str
    """A word for the type: boolean, whole number, number, text, or texts."""
    allowed: str
    changes: str
    """When the parameter can be changed, as in `kernel.ranges.Change`."""
    about: str


class ParameterList(TypedDict):
    """The answer of `param_list`: all parameters of the configuration."""

    parameters: list[ParameterAnswer]


class ParameterSet(MessageAnswer):
    """The answer of `param_set`: the parameter's key, its old value and its new value."""

    key: str
    old: bool | int | float | str | list[str]
    new: bool | int | float | str | list[str]


class SimFaulted(MessageAnswer):
    """The answer of `sim_fault`, sent once the mode is not MOVING, or 1 s after the fault ended."""

    mode: str
    stopped_after_ms: float | None
    """Time from the fault to the end of MOVING, None if the robot went on or was not moving."""


class NameAndTypes(TypedDict):
    """A topic or a service, with its full name and its types (normally one)."""

    name: str
    types: list[str]


class Graph(TypedDict):
    """The names that the daemon sees on ROS. `left_out` counts the names above a limit."""

    topics: list[NameAndTypes]
    services: list[NameAndTypes]
    nodes: list[str]
    left_out: int


class GraphEndpoint(TypedDict):
    """A publisher or a subscription. `node` is "" while its node is unknown."""

    node: str
    type: str
    gid: str
    qos: dict[str, str | int]


class GraphTopic(TypedDict):
    """A topic with its publishers and subscriptions. Both lists are empty for an unknown topic."""

    name: str
    types: list[str]
    publishers: list[GraphEndpoint]
    subscriptions: list[GraphEndpoint]


class GraphNode(TypedDict):
    """A node with the topics and services that it publishes, subscribes to, serves and calls."""

    name: str
    publishers: list[NameAndTypes]
    subscriptions: list[NameAndTypes]
    servers: list[NameAndTypes]
    clients: list[NameAndTypes]
