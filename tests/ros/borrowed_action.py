"""An action type for tests that counts up to a number, made of existing interfaces.

No ROS wheel contains an action type, and building one takes a compiler and a minute. So existing
types are sent instead: diagnostic_msgs/srv/AddDiagnostics for goal and result, std_msgs/msg/String
for feedback, all values as text. rclpy and rcl_action see a complete action type.
"""

from __future__ import annotations

import ctypes
from typing import Any

from action_msgs.msg import GoalStatusArray
from action_msgs.srv import CancelGoal
from builtin_interfaces.msg import Time
from diagnostic_msgs.srv import AddDiagnostics
from rclpy.type_support import check_for_type_support
from std_msgs.msg import String
from unique_identifier_msgs.msg import UUID

for _type in (GoalStatusArray, CancelGoal, AddDiagnostics, String, UUID, Time):
    check_for_type_support(_type)

_FROM_PY = ctypes.PYFUNCTYPE(ctypes.c_bool, ctypes.py_object, ctypes.c_void_p)
_TO_PY = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p)
_kept: list[Any] = []


def _pointer(capsule: Any) -> int:
    api = ctypes.pythonapi
    api.PyCapsule_GetName.restype = ctypes.c_char_p
    api.PyCapsule_GetName.argtypes = [ctypes.py_object]
    api.PyCapsule_GetPointer.restype = ctypes.c_void_p
    api.PyCapsule_GetPointer.argtypes = [ctypes.py_object, ctypes.c_char_p]
    address: int = api.PyCapsule_GetPointer(capsule, api.PyCapsule_GetName(capsule))
    return address


def _capsule(address: int | None) -> Any:
    api = ctypes.pythonapi
    api.PyCapsule_New.restype = ctypes.py_object
    api.PyCapsule_New.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
    return api.PyCapsule_New(address, None, None)


def _travels_as(carrier: Any) -> type:
    """Return a metaclass whose classes are sent as `carrier`, by their `pack` and `unpack`."""
    meta = type(carrier)
    real_from_py = _FROM_PY(_pointer(meta._CONVERT_FROM_PY))
    real_to_py = _TO_PY(_pointer(meta._CONVERT_TO_PY))

    class Travelling(type):
        _TYPE_SUPPORT = meta._TYPE_SUPPORT
        _CREATE_ROS_MESSAGE = meta._CREATE_ROS_MESSAGE
        _DESTROY_ROS_MESSAGE = meta._DESTROY_ROS_MESSAGE

        def __new__(cls, name: str, bases: tuple[type, ...], body: dict[str, Any]) -> Any:
            own: Any = type(f"Metaclass_{name}", (Travelling,), {})
            made: Any = type.__new__(own, name, bases, body)
            from_py = _FROM_PY(lambda message, memory: real_from_py(message.pack(), memory))
            to_py = _TO_PY(lambda memory: made.unpack(real_to_py(memory)))
            _kept.extend((from_py, to_py))
            own._CONVERT_FROM_PY = _capsule(ctypes.cast(from_py, ctypes.c_void_p).value)
            own._CONVERT_TO_PY = _capsule(ctypes.cast(to_py, ctypes.c_void_p).value)
            return made

    return Travelling


class Number:
    """The base of goal, result and feedback, which are one number each."""

    def __init__(self, value: int = 0) -> None:
        self.value = value


class GoalRequest(metaclass=_travels_as(AddDiagnostics.Request)):  # type: ignore[metaclass]
    def __init__(self) -> None:
        self.goal_id = UUID()
        self.goal = Number()

    def pack(self) -> Any:
        name = f"{bytes(self.goal_id.uuid).hex()} {self.goal.value}"
        return AddDiagnostics.Request(load_namespace=name)

    @classmethod
    def unpack(cls, carrier: Any) -> GoalRequest:
        made = cls()
        identity, value = carrier.load_namespace.split()
        made.goal_id.uuid = list(bytes.fromhex(identity))
        made.goal = Number(int(value))
        return made


class GoalReply(metaclass=_travels_as(AddDiagnostics.Response)):  # type: ignore[metaclass]
    def __init__(self) -> None:
        self.accepted = False
        self.stamp = Time()

    def pack(self) -> Any:
        stamp = f"{self.stamp.sec} {self.stamp.nanosec}"
        return AddDiagnostics.Response(success=self.accepted, message=stamp)

    @classmethod
    def unpack(cls, carrier: Any) -> GoalReply:
        made = cls()
        made.accepted = carrier.success
        sec, nanosec = carrier.message.split()
        made.stamp = Time(sec=int(sec), nanosec=int(nanosec))
        return made


class ResultRequest(metaclass=_travels_as(AddDiagnostics.Request)):  # type: ignore[metaclass]
    def __init__(self) -> None:
        self.goal_id = UUID()

    def pack(self) -> Any:
        return AddDiagnostics.Request(load_namespace=bytes(self.goal_id.uuid).hex())

    @classmethod
    def unpack(cls, carrier: Any) -> ResultRequest:
        made = cls()
        made.goal_id.uuid = list(bytes.fromhex(carrier.load_namespace))
        return made


class ResultReply(metaclass=_travels_as(AddDiagnostics.Response)):  # type: ignore[metaclass]
    def __init__(self) -> None:
        self.status = 0
        self.result = Number()

    def pack(self) -> Any:
        text = f"{self.status} {self.result.value}"
        return AddDiagnostics.Response(success=True, message=text)

    @classmethod
    def unpack(cls, carrier: Any) -> ResultReply:
        made = cls()
        status, value = carrier.message.split()
        made.status = int(status)
        made.result = Number(int(value))
        return made


class FeedbackMessage(metaclass=_travels_as(String)):  # type: ignore[metaclass]
    def __init__(self) -> None:
        self.goal_id = UUID()
        self.feedback = Number()

    def pack(self) -> Any:
        return String(data=f"{bytes(self.goal_id.uuid).hex()} {self.feedback.value}")

    @classmethod
    def unpack(cls, carrier: Any) -> FeedbackMessage:
        made = cls()
        identity, value = carrier.data.split()
        made.goal_id.uuid = list(bytes.fromhex(identity))
        made.feedback = Number(int(value))
        return made


class _SendGoal:
    Request = GoalRequest
    Response = GoalReply


class _GetResult:
    Request = ResultRequest
    Response = ResultReply


_carrier = _pointer(type(String)._TYPE_SUPPORT)

# rosidl_action_type_support_t: five type supports, then the functions that describe the type;
# these ignore their argument, so a message's do (they follow identifier, data and dispatcher).
_support = (ctypes.c_void_p * 8)(
    _pointer(type(AddDiagnostics)._TYPE_SUPPORT),
    _pointer(type(AddDiagnostics)._TYPE_SUPPORT),
    _pointer(type(CancelGoal)._TYPE_SUPPORT),
    _carrier,
    _pointer(type(GoalStatusArray)._TYPE_SUPPORT),
    *(ctypes.c_void_p * 6).from_address(_carrier)[3:],
)


class _CountMeta(type):
    _TYPE_SUPPORT = _capsule(ctypes.addressof(_support))


class Count(metaclass=_CountMeta):
    """The action: count to goal.value; feedback is each number, the result their sum."""

    Goal = Number
    Result = Number
    Feedback = Number

    class Impl:
        SendGoalService = _SendGoal
        GetResultService = _GetResult
        CancelGoalService = CancelGoal
        FeedbackMessage = FeedbackMessage
        GoalStatusMessage = GoalStatusArray
