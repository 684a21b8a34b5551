"""The pure core: modes, safety, patterns, tracking, limits. No clock, no I/O, no ROS.

The names in `__all__` are for users of the library; the modules below may change. `step` returns
the effects that the caller must carry out, in order:

    from robotctl.kernel import Kernel, KernelParams, Mode, ModeRequested

    kernel = Kernel(KernelParams())
    effects = kernel.step(ModeRequested(t_ns=0, request_id=1, requested=Mode.IDLE, source="me"))

Each event carries its time, in nanoseconds of a steady clock. A `Snapshot` and the events after it
give the same effects again, bit for bit.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robotctl.kernel.codec import Snapshot, from_json, to_json
    from robotctl.kernel.geometry import Pose
    from robotctl.kernel.kernel import Kernel
    from robotctl.kernel.modes import Mode
    from robotctl.kernel.params import (
        BatteryParams,
        BatteryScale,
        CommandParams,
        KernelParams,
        OdometryParams,
        TrackingParams,
        VelocityLimits,
    )
    from robotctl.kernel.patterns import Pattern, PatternKind
    from robotctl.kernel.state import State, latched
    from robotctl.kernel.types import (
        BatteryReceived,
        Cause,
        CommandListenersSeen,
        CommandPublishersSeen,
        DriveEnded,
        DriveReport,
        DriveRequested,
        Effect,
        Event,
        FaultCleared,
        FaultReported,
        ForeignCommandHeard,
        GuardedCommandReceived,
        HoldReceived,
        LatchEmergencyStop,
        Lease,
        LeaseLost,
        LeaseRequested,
        LifecycleChanged,
        LifecycleState,
        LoopStalled,
        ModeChanged,
        ModeRequested,
        Odometry,
        OdometrySourceFound,
        OdomReceived,
        ParameterChanged,
        ParameterRequested,
        Phase,
        PublishTwist,
        ReleaseEmergencyStop,
        Remedy,
        Reply,
        ResetRequested,
        SafetyInputReceived,
        ScanReceived,
        Tick,
        Twist,
    )

__all__ = [
    "BatteryParams",
    "BatteryReceived",
    "BatteryScale",
    "Cause",
    "CommandListenersSeen",
    "CommandParams",
    "CommandPublishersSeen",
    "DriveEnded",
    "DriveReport",
    "DriveRequested",
    "Effect",
    "Event",
    "FaultCleared",
    "FaultReported",
    "ForeignCommandHeard",
    "GuardedCommandReceived",
    "HoldReceived",
    "Kernel",
    "KernelParams",
    "LatchEmergencyStop",
    "Lease",
    "LeaseLost",
    "LeaseRequested",
    "LifecycleChanged",
    "LifecycleState",
    "LoopStalled",
    "Mode",
    "ModeChanged",
    "ModeRequested",
    "OdomReceived",
    "Odometry",
    "OdometryParams",
    "OdometrySourceFound",
    "ParameterChanged",
    "ParameterRequested",
    "Pattern",
    "PatternKind",
    "Phase",
    "Pose",
    "PublishTwist",
    "ReleaseEmergencyStop",
    "Remedy",
    "Reply",
    "ResetRequested",
    "SafetyInputReceived",
    "ScanReceived",
    "Snapshot",
    "State",
    "Tick",
    "TrackingParams",
    "Twist",
    "VelocityLimits",
    "from_json",
    "latched",
    "to_json",
]

_MODULES = ("types", "patterns", "params", "state", "kernel", "codec")
"""The modules in which `__getattr__` searches for a public name, in order."""


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module  # here: `robotctl status` imports this package

    modules = (import_module(f"{__name__}.{each}") for each in _MODULES)
    return next(getattr(module, name) for module in modules if hasattr(module, name))
