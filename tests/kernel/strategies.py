"""Hypothesis strategies for all events that may reach the kernel, valid or not."""

from __future__ import annotations

from math import inf, nan

from hypothesis import strategies as st

from robotctl.config import Config, flat
from robotctl.kernel.course import Course, Frame, Held
from robotctl.kernel.geometry import Pose
from robotctl.kernel.parameter_keys import kernel_leaves
from robotctl.kernel.patterns import Pattern, PatternKind
from robotctl.kernel.safety_inputs import SafetyInput
from robotctl.kernel.types import (
    BatteryReceived,
    Cause,
    CommandListenersSeen,
    CommandPublishersSeen,
    DriveRequested,
    Event,
    FaultCleared,
    FaultReported,
    ForeignCommandHeard,
    GuardedCommandReceived,
    HoldReceived,
    LeaseLost,
    LeaseRequested,
    LifecycleChanged,
    LifecycleState,
    LoopStalled,
    ModeRequested,
    Odometry,
    OdometrySourceFound,
    OdomReceived,
    ParameterRequested,
    ResetRequested,
    SafetyInputReceived,
    ScanReceived,
    Tick,
    Twist,
)

INT64 = st.integers(-(2**63), 2**63 - 1)
ANY_FLOAT = st.floats(allow_nan=True, allow_infinity=True)
SPECIAL_FLOAT = st.sampled_from((nan, inf, -inf, 0.0, -0.0, 1e308, -1e308, 5e-324))
NEAR = st.floats(-2.0, 2.0)
COORDINATE = st.one_of(NEAR, NEAR, ANY_FLOAT, SPECIAL_FLOAT)
LEVEL = st.one_of(st.floats(0.0, 1.0), st.sampled_from((0.15, 0.2)), ANY_FLOAT, SPECIAL_FLOAT)
MODE_NUMBER = st.one_of(st.integers(0, 3), st.integers(-1, 260))
SOURCE = st.text(max_size=8)
NAMES = st.lists(SOURCE, max_size=2).map(tuple)
DAEMON_CAUSE = st.sampled_from(
    (Cause.TASK_DIED, Cause.LOOP_STALLED, Cause.RECORDER_FAILED, Cause.DAEMON_ENDS)
)

TWIST = st.builds(Twist, COORDINATE, COORDINATE)
ODOMETRY = st.builds(Odometry, st.builds(Pose, COORDINATE, COORDINATE, COORDINATE), TWIST, INT64)
PATTERN = st.builds(
    Pattern,
    st.sampled_from(PatternKind),
    st.one_of(st.floats(0.1, 3.0), ANY_FLOAT),
    st.one_of(st.floats(0.01, 3.0), ANY_FLOAT),
)
POINT = st.tuples(COORDINATE, COORDINATE)
COURSE = st.builds(
    Course,
    st.one_of(st.just(0.1), st.just(0.0), st.floats(0.02, 0.5), ANY_FLOAT),
    st.one_of(st.floats(-4.0, 4.0), ANY_FLOAT),
    st.booleans(),
    st.booleans(),
    st.one_of(st.just(()), st.lists(POINT, max_size=6).map(tuple)),
    st.sampled_from(Frame),
    st.one_of(
        st.none(),
        st.none(),
        st.builds(Held, COORDINATE, COORDINATE, st.one_of(st.floats(0.02, 2.0), ANY_FLOAT)),
        st.builds(Held, COORDINATE, COORDINATE, st.just(0.125), st.just(0)),
    ),
)
PARAMETER = st.one_of(st.sampled_from(sorted(kernel_leaves())), SOURCE)
PARAMETER_TEXT = st.one_of(
    st.sampled_from(sorted({str(value) for value in flat(Config()).values()})),
    st.floats(0.0, 10.0).map(repr),
    SOURCE,
)


CLIENT = st.integers(0, 2)


def event(
    t_ns: st.SearchStrategy[int], request_id: st.SearchStrategy[int]
) -> st.SearchStrategy[Event]:
    """Return a strategy of events with these times and request numbers."""
    cause = st.one_of(DAEMON_CAUSE, st.sampled_from(Cause))
    return st.one_of(
        st.builds(Tick, t_ns, st.integers(0, 10)),
        st.builds(OdomReceived, t_ns, ODOMETRY, st.integers(0, 3), st.integers(0, 2**40)),
        st.builds(OdometrySourceFound, t_ns, st.integers(0, 3), SOURCE, SOURCE),
        st.builds(BatteryReceived, t_ns, LEVEL),
        st.builds(ScanReceived, t_ns, st.lists(LEVEL, max_size=64).map(tuple)),
        st.builds(SafetyInputReceived, t_ns, st.sampled_from(SafetyInput), LEVEL, SOURCE),
        st.builds(LifecycleChanged, t_ns, st.sampled_from(LifecycleState), SOURCE),
        st.builds(ModeRequested, t_ns, request_id, MODE_NUMBER, SOURCE, CLIENT),
        st.builds(ResetRequested, t_ns, request_id, SOURCE),
        st.builds(
            DriveRequested,
            t_ns,
            request_id,
            PATTERN,
            st.integers(-1, 3),
            st.booleans(),
            SOURCE,
            CLIENT,
            SOURCE,
            COURSE,
        ),
        st.builds(LeaseRequested, t_ns, request_id, st.booleans(), CLIENT, SOURCE),
        st.builds(LeaseLost, t_ns, CLIENT),
        st.builds(GuardedCommandReceived, t_ns, TWIST),
        st.builds(HoldReceived, t_ns, request_id, TWIST, CLIENT),
        st.builds(
            ParameterRequested, t_ns, request_id, PARAMETER, PARAMETER_TEXT, PARAMETER_TEXT, SOURCE
        ),
        st.builds(CommandPublishersSeen, t_ns, NAMES),
        st.builds(ForeignCommandHeard, t_ns, SOURCE),
        st.builds(CommandListenersSeen, t_ns, st.integers(0, 3), NAMES),
        st.builds(LoopStalled, t_ns, LEVEL, st.integers(0, 9), st.integers(0, 9), SOURCE),
        st.builds(FaultReported, t_ns, cause, SOURCE),
        st.builds(FaultCleared, t_ns, cause),
    )
