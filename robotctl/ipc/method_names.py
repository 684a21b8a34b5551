"""The methods of the control socket that commands call, each with the type of its answer."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, Generic, TypeVar

# For type checking only, so that `robotctl status` starts faster.
if TYPE_CHECKING:
    from robotctl.ipc.answers import (
        Committed,
        DriveAnswer,
        DrivenPath,
        FileSplit,
        Graph,
        GraphNode,
        GraphTopic,
        HoldAnswer,
        LeaseKept,
        LeaseStatus,
        Marked,
        MessageAnswer,
        ModeAnswer,
        ParameterList,
        ParameterSet,
        Preflight,
        RecordStatus,
        SimFaulted,
        Status,
    )

A_co = TypeVar("A_co", covariant=True)


class MethodName(str, Generic[A_co]):
    """The name of a method. Its answer has the type `A_co`."""

    __slots__ = ()


STATUS: Final[MethodName[Status]] = MethodName("status")
PREFLIGHT: Final[MethodName[Preflight]] = MethodName("preflight")
STOP: Final[MethodName[MessageAnswer]] = MethodName("stop")
PATH: Final[MethodName[DrivenPath]] = MethodName("path")
SET_MODE: Final[MethodName[ModeAnswer]] = MethodName("set_mode")
RESET: Final[MethodName[ModeAnswer]] = MethodName("reset")
DRIVE: Final[MethodName[DriveAnswer]] = MethodName("drive")
DRIVE_PATH: Final[MethodName[DriveAnswer]] = MethodName("drive_path")
HOLD: Final[MethodName[HoldAnswer]] = MethodName("hold")
DRIVE_VELOCITY: Final[MethodName[DriveAnswer]] = MethodName("drive_velocity")
END_DRIVE: Final[MethodName[ModeAnswer]] = MethodName("end_drive")
LEASE_TAKE: Final[MethodName[MessageAnswer]] = MethodName("lease_take")
LEASE_KEEP: Final[MethodName[LeaseKept]] = MethodName("lease_keep")
LEASE_RELEASE: Final[MethodName[MessageAnswer]] = MethodName("lease_release")
LEASE_STATUS: Final[MethodName[LeaseStatus]] = MethodName("lease_status")
RECORD_STATUS: Final[MethodName[RecordStatus]] = MethodName("record_status")
RECORD_COMMIT: Final[MethodName[Committed]] = MethodName("record_commit")
RECORD_SPLIT: Final[MethodName[FileSplit]] = MethodName("record_split")
MARK: Final[MethodName[Marked]] = MethodName("mark")
PARAM_LIST: Final[MethodName[ParameterList]] = MethodName("param_list")
PARAM_SET: Final[MethodName[ParameterSet]] = MethodName("param_set")
SIM_SET: Final[MethodName[MessageAnswer]] = MethodName("sim_set")
SIM_FAULT: Final[MethodName[SimFaulted]] = MethodName("sim_fault")
GRAPH: Final[MethodName[Graph]] = MethodName("graph")
GRAPH_TOPIC: Final[MethodName[GraphTopic]] = MethodName("graph_topic")
GRAPH_NODE: Final[MethodName[GraphNode]] = MethodName("graph_node")

OF_A_ROBOT: Final = (
    *(PREFLIGHT, PATH, SET_MODE, RESET, DRIVE, DRIVE_PATH, DRIVE_VELOCITY, END_DRIVE, HOLD),
    *(LEASE_TAKE, LEASE_KEEP, LEASE_RELEASE, LEASE_STATUS, PARAM_SET, SIM_SET, SIM_FAULT),
)
"""The methods of a daemon that drives. A daemon that only observes refuses each of them."""
