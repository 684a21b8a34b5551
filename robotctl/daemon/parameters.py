"""The parameters of a running daemon."""

from __future__ import annotations

from collections.abc import Callable, Container, Sequence
from dataclasses import replace
from typing import Any

from robotctl.base.errors import Refused, RobotctlError
from robotctl.config import Config, check_together, declarations, flat, with_setting, with_text
from robotctl.config.ros_settings import MODE_SERVICE, SIMULATED_ROBOT, node_of
from robotctl.daemon.control.dispatcher import Control
from robotctl.ipc.advice import advice
from robotctl.ipc.answers import ParameterAnswer, ParameterList, ParameterSet
from robotctl.ipc.method_names import PARAM_LIST, PARAM_SET
from robotctl.ipc.method_params import NoParams, ParamSetParams
from robotctl.ipc.server import Method
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.parameter_keys import kernel_leaves
from robotctl.kernel.ranges import Change
from robotctl.kernel.types import ParameterChanged, ParameterRequested, Reply
from robotctl.ros.nodes.node_services import ParameterServices
from robotctl.ros.session import Session

START_CURE = "stop the daemon, and start it with --config, or with --ros-args -p {key}:=VALUE"


Setting = tuple[str, Any]
"""A key and its new value, as in a configuration file."""


class Parameters:
    """Reads and changes a running daemon's configuration, of which the kernel owns its own part."""

    def __init__(
        self, config: Config, control: Control, on_change: Callable[[Config], None]
    ) -> None:
        """Call `on_change(config)` after each change."""
        self._config = config
        self._control = control
        self._on_change = on_change
        self.followers: list[Callable[[str, object], None]] = []
        """Called with key and value after each change."""

    @property
    def config(self) -> Config:
        """The present configuration."""
        return replace(self._config, kernel=self._control.params)

    def request(self, settings: Sequence[Setting], source: str) -> Reply:
        """Change all parameters and return the last reply, or change none and return a refusal.

        Raises:
            ConfigError: There is no such key, or a value is not allowed.
            Refused: One of the parameters can change only at a start.
        """
        events, config = [], self.config
        for key, value in settings:
            before, config = config, with_setting(config, key, value)
            if declarations()[key].change is Change.START:
                raise Refused(f"{key} changes at a start only", START_CURE.format(key=key))
            check_together(config.kernel)
            events.append(
                ParameterRequested(
                    *self._control.stamp(),
                    key,
                    str(flat(before)[key]),
                    str(flat(config)[key]),
                    source,
                )
            )
        if len(events) > 1:
            trial = Kernel(self._control.params, self._control.state)
            for event in events:
                (*_, reply) = trial.step(event)
                if isinstance(reply, Reply) and not reply.ok:
                    return reply
        return [self._control.decide(event) for event in events][-1]

    def changed(self, change: ParameterChanged) -> None:
        """Apply a change that the kernel granted, then call `on_change` and all `followers`."""
        if change.key not in kernel_leaves():
            self._config = with_text(self._config, change.key, change.new)
        config = self.config
        self._on_change(config)
        value = flat(config)[change.key]
        for follow in self.followers:
            follow(change.key, value)


def listed(config: Config) -> list[ParameterAnswer]:
    """Return every parameter with its value in `config`."""
    values: dict[str, Any] = flat(config)
    return [
        {
            "key": key,
            "value": values[key],
            "default": each.default,
            "type": each.kind.value,
            "allowed": each.allowed,
            "changes": each.change.value,
            "about": each.about,
        }
        for key, each in declarations().items()
    ]


def serve_parameters(session: Session, parameters: Parameters, robot: str) -> None:
    """Serve the ROS parameters of each visible node."""

    def ask(settings: Sequence[Setting], source: str) -> str:
        try:
            reply = parameters.request(settings, source)
        except RobotctlError as error:
            return str(error)
        return "" if reply.ok else advice(reply.message, reply.remedies, robot).sentence

    values = flat(parameters.config)
    for name, node in session.visible_nodes.items():
        declared = [
            (each, values[each.key])
            for each in declarations().values()
            if _served_by(each.key, session.visible_nodes) == name
        ]
        parameters.followers.append(ParameterServices(node, declared, ask).show)


def _served_by(key: str, nodes: Container[str]) -> str:
    """Return the name of the node that serves a key."""
    node = node_of(key)  # keys of a simulated robot that does not run are not served
    return node if node in nodes or node == SIMULATED_ROBOT else MODE_SERVICE


def list_method(config: Callable[[], Config]) -> dict[str, Method[Any]]:
    """Return the method `param_list` by name, which lists the parameters in `config()`."""

    async def get_list(_: NoParams) -> ParameterList:
        return {"parameters": listed(config())}

    return {PARAM_LIST: Method(NoParams, get_list)}


def parameter_methods(parameters: Parameters, robot: str) -> dict[str, Method[Any]]:
    """Return the methods `param_list` and `param_set` by name."""

    async def set_one(params: ParamSetParams) -> ParameterSet:
        wanted = flat(with_text(parameters.config, params.key, params.value))[params.key]
        old = _value(parameters, params.key)
        reply = parameters.request([(params.key, wanted)], params.source)
        if not reply.ok:
            raise Refused(*advice(reply.message, reply.remedies, robot))
        return {
            "message": reply.message,
            "key": params.key,
            "old": old,
            "new": _value(parameters, params.key),
        }

    return {
        **list_method(lambda: parameters.config),
        PARAM_SET: Method(ParamSetParams, set_one),
    }


def _value(parameters: Parameters, key: str) -> Any:
    return flat(parameters.config)[key]
