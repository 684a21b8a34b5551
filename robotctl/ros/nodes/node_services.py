# mypy: disallow-untyped-calls=False, disallow-subclassing-any=False
"""The services of a node for its parameters, the levels of loggers and its lifecycle."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Sequence
from typing import Any, Final

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    LoggerLevel,
    ParameterDescriptor,
    SetLoggerLevelsResult,
    SetParametersResult,
)
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.lifecycle.node import LifecycleNode
from rclpy.logging import set_logger_level
from rclpy.logging_service import LoggingService
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_service import ParameterService

from robotctl.base.text import printable
from robotctl.config import Declaration
from robotctl.kernel.ranges import Change
from robotctl.kernel.types import LifecycleState
from robotctl.ros import qos

Ask = Callable[[Sequence[tuple[str, Any]], str], str]
"""Called with (key, new value) pairs, to set all or none, and the name of the asking service.
Returns the reason for a refusal, or "".
"""


class ParameterServices(ParameterService):
    """The six parameter services of a node. The function `ask` applies or refuses new values."""

    # rclpy checks types, ranges and read-only parameters of a request before `ask`.
    def __init__(self, node: Node, values: Sequence[tuple[Declaration, Any]], ask: Ask) -> None:
        """Declare each parameter on `node`, with its present value."""
        self._node_weak_ref = weakref.ref(node)
        self._ask = ask
        self._asking = self._showing = False
        self._keys = {declared.key for declared, _ in values}
        for declared, value in values:
            _declare(node, declared, value)
        node.add_on_set_parameters_callback(self._decide)
        self._name = node.get_fully_qualified_name()
        kinds: tuple[tuple[Any, str, Callable[..., Any]], ...] = (
            (DescribeParameters, "describe_parameters", self._describe_parameters_callback),
            (GetParameters, "get_parameters", self._get_parameters_callback),
            (GetParameterTypes, "get_parameter_types", self._get_parameter_types_callback),
            (ListParameters, "list_parameters", self._list_parameters_callback),
            (SetParameters, "set_parameters", self._set_one_by_one),
            (SetParametersAtomically, "set_parameters_atomically", self._set_all_or_none),
        )
        for kind, service, handler in kinds:
            node.create_service(
                kind, f"{node.get_name()}/{service}", handler, qos_profile=qos.PARAMETERS
            )

    def show(self, key: str, value: Any) -> None:
        """Update the node's parameter `key`, if it exists, to the daemon's present `value`."""
        if key not in self._keys or self._asking:  # rclpy stores accepted values itself
            return
        self._showing = True
        try:
            self._get_node().set_parameters([Parameter(key, value=value)])
        finally:
            self._showing = False

    def _set_one_by_one(self, request: Any, response: Any) -> Any:
        response.results = [self._set([each]) for each in request.parameters]
        return response

    def _set_all_or_none(self, request: Any, response: Any) -> Any:
        response.result = self._set(request.parameters)
        return response

    def _set(self, messages: Sequence[Any]) -> SetParametersResult:
        node = self._get_node()
        for each in messages:
            if not node.has_parameter(each.name):  # rclpy's own text does not name it
                reason = f"{self._name} has no parameter {printable(each.name[:80])}"
                return SetParametersResult(successful=False, reason=reason)
        try:
            parameters = [Parameter.from_parameter_msg(each) for each in messages]
        except (RuntimeError, TypeError, ValueError) as error:  # a type that does not exist
            return SetParametersResult(successful=False, reason=printable(str(error)))
        return node.set_parameters_atomically(parameters)

    def _decide(self, parameters: list[Parameter]) -> SetParametersResult:
        wanted = [(each.name, each.value) for each in parameters if each.name in self._keys]
        if self._showing or not wanted:
            return SetParametersResult(successful=True)
        self._asking = True
        try:
            refusal = self._ask(wanted, f"the ROS service {self._name}/set_parameters")
        finally:
            self._asking = False
        return SetParametersResult(successful=not refusal, reason=refusal)


def _declare(node: Node, declared: Declaration, value: Any) -> None:
    descriptor = ParameterDescriptor(
        description=declared.about,
        additional_constraints=f"{declared.allowed}; changes {declared.change.value}",
        read_only=declared.change is Change.START,
    )
    if declared.range is not None and isinstance(value, int):
        low, high, _ = declared.range
        descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high))]
    elif declared.range is not None:
        low, high = float(declared.range.low), float(declared.range.high)
        descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
    if not isinstance(value, list):
        node.declare_parameter(declared.key, value, descriptor)
        return
    texts = Parameter.Type.STRING_ARRAY
    node.declare_parameter(declared.key, texts, descriptor)
    # Not by a method of Node: each would take an empty list for an array of bytes.
    node._parameters[declared.key] = Parameter(declared.key, texts, value)


MAX_LEVELS: Final = 100
"""Limit on the loggers in one call, since a long list would block the loop."""

Get = Callable[[str], int]
"""Returns the level of a logger, or 0 if the logger has none."""

Set = Callable[[str, int, str], str]
"""Called with a logger, its new level and the asking service. Returns why it was refused, or ""."""


class LoggerServices(LoggingService):
    """The services `get_logger_levels` and `set_logger_levels` of a node, as rclpy offers them."""

    def __init__(self, node: Node, get: Get, set_level: Set) -> None:
        self._get = get
        self._set = set_level
        self._source = f"the ROS service {node.get_fully_qualified_name()}/set_logger_levels"
        super().__init__(node)

    def _get_logger_levels(self, request: Any, response: Any) -> Any:
        response.levels = [
            LoggerLevel(name=name, level=self._get(name)) for name in request.names[:MAX_LEVELS]
        ]
        return response

    def _set_logger_levels(self, request: Any, response: Any) -> Any:
        asked = request.levels
        reasons = [self._set(each.name, each.level, self._source) for each in asked[:MAX_LEVELS]]
        results = [SetLoggerLevelsResult(successful=not each, reason=each) for each in reasons]
        left_out = SetLoggerLevelsResult(reason=f"more than {MAX_LEVELS} levels in one call")
        response.results = [*results, *[left_out] * len(asked[MAX_LEVELS:])]
        return response


def set_native_level(name: str, level: int) -> str:
    """Set the level of a logger of rcl or rclpy. Return the reason for a failure, or ""."""
    try:
        set_logger_level(name, level, detailed_error=True)
    except (RuntimeError, TypeError, ValueError) as error:  # TypeError: not UTF-8
        return str(error)
    return ""


class ManagedNode(LifecycleNode):
    """A node with the lifecycle services. Its other interfaces work in every lifecycle state.

    `changed(state)` is called after each request for a transition, even without a change.
    """

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        self.changed: Callable[[LifecycleState], None] = lambda state: None
        service: Any = self._service_change_state
        self._change: Callable[[Any, Any], Any] = service.callback
        service.callback = self._change_state

    @property
    def state(self) -> LifecycleState:
        """The present lifecycle state."""
        _, label = self._state_machine.current_state
        return LifecycleState(label)

    def start(self) -> None:
        """Configure and activate the node."""
        node: Any = self  # rclpy's methods have no types
        node.trigger_configure()
        node.trigger_activate()

    def destroy_node(self) -> None:
        """Destroy the node, and then its state machine, which would keep the context alive."""
        Node.destroy_node(self)
        self._state_machine.destroy_when_not_in_use()

    def _change_state(self, request: Any, response: Any) -> Any:
        try:
            response = self._change(request, response)
        except _rclpy.RCLError:  # this state does not have the transition
            response.success = False
        self.changed(self.state)
        return response
