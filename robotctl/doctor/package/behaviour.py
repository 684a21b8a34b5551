"""What nodes do wrong when they run: qualities of service that do not match, waits in callbacks."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import Final, NamedTuple

from robotctl.doctor.finding import Finding, fault
from robotctl.doctor.package.constants import called, calls, keyword, text_of
from robotctl.doctor.package.package_files import Package

SPINS: Final = (
    "spin",
    "spin_once",
    "spin_until_future_complete",
    "spin_once_until_future_complete",
)

TAKES_CALLBACKS: Final = (
    *("create_subscription", "create_timer", "create_service", "ActionServer"),
    *("add_done_callback", "add_on_set_parameters_callback", "create_client", "Subscription"),
)

CALLBACK_GROUPS: Final = ("ReentrantCallbackGroup", "MutuallyExclusiveCallbackGroup")

SENSOR_DATA: Final = ("qos_profile_sensor_data", "SensorDataQoS", "SENSOR_DATA")


class CodeEndpoint(NamedTuple):
    """A publisher or subscription in the code; what cannot be told is ""."""

    place: str
    topic: str
    reliability: str
    durability: str


def check_qos(packages: list[Package]) -> Iterator[Finding]:
    """Each subscription gets what a publisher of the workspace offers on its topic."""
    offered = list(_endpoints(packages, "create_publisher"))
    for asked in _endpoints(packages, "create_subscription"):
        for offer in offered:
            if offer.topic != asked.topic:
                continue
            for policy, weak, strong in (
                ("reliability", "best_effort", "reliable"),
                ("durability", "volatile", "transient_local"),
            ):
                if getattr(offer, policy) == weak and getattr(asked, policy) == strong:
                    yield fault(
                        "QoS",
                        f"{asked.place} hears nothing of {offer.place} on {asked.topic}: "
                        f"{policy} {weak} is offered, {strong} asked for",
                        f"let the subscription ask for {weak}, or the publisher offer {strong}",
                    )


def check_spin_in_callback(package: Package) -> Iterator[Finding]:
    """No callback spins or waits for a service: the executor that would go on runs the callback."""
    for path, tree in package.ros_modules.items():
        functions = {
            each.name: each
            for each in ast.walk(tree)
            if isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef)
        }
        clients = _clients(tree)
        told: set[int] = set()
        for name in _callbacks(tree, functions):
            for call in calls(functions[name]):
                waits = called(call) == "call" and _target(call) in clients
                spins = called(call) in SPINS and _target(call) == "rclpy"
                spins = spins and keyword(call, "executor") is None
                if (spins or waits) and call.lineno not in told:
                    told.add(call.lineno)
                    what = "waits for a service" if waits else f"calls {called(call)}"
                    yield fault(
                        "spin in a callback",
                        f"{path}:{call.lineno}: {name}, a callback, {what}: the node hangs",
                        "use call_async and add_done_callback, or await it in an async callback",
                    )


def _endpoints(packages: list[Package], function: str) -> Iterator[CodeEndpoint]:
    for package in packages:
        for path, tree in package.ros_modules.items():
            profiles = _assigned(tree)
            for call in calls(tree):
                if called(call) != function:
                    continue
                topic = text_of(_argument(call, 1, "topic"), {})
                place = 3 if function == "create_subscription" else 2
                profile = _argument(call, place, "qos_profile")
                if topic is not None and profile is not None:
                    where = f"{package.name}/{path}:{call.lineno}"
                    yield CodeEndpoint(where, topic.lstrip("/"), *_policies(profile, profiles))


def _policies(profile: ast.expr, assigned: dict[str, ast.expr]) -> tuple[str, str]:
    """Return reliability and durability of an argument for the quality of service."""
    name = _target_name(profile)
    if name in SENSOR_DATA:
        return "best_effort", "volatile"
    if isinstance(profile, ast.Constant):
        return "reliable", "volatile"
    if name in assigned and assigned[name] is not profile:
        return _policies(
            assigned[name], {key: each for key, each in assigned.items() if key != name}
        )
    if isinstance(profile, ast.Call) and called(profile) == "QoSProfile":
        return (
            _policy(keyword(profile, "reliability"), "reliable"),
            _policy(keyword(profile, "durability"), "volatile"),
        )
    return "", ""


def _policy(given: ast.expr | None, default: str) -> str:
    return default if given is None else _target_name(given).lower()


def _assigned(tree: ast.Module) -> dict[str, ast.expr]:
    """Return the names, also those of `self`, that are set exactly once, and never given."""
    found: dict[str, list[ast.expr]] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign):
            for target in node.targets:
                found.setdefault(_target_name(target), []).append(node.value)
        elif isinstance(node, ast.AugAssign | ast.AnnAssign):
            found.setdefault(_target_name(node.target), []).extend(
                [node.value, node.value] if node.value else []
            )
    changed = {
        _target_name(node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store)
    } | {node.arg for node in ast.walk(tree) if isinstance(node, ast.arg)}
    return {
        name: values[0]
        for name, values in found.items()
        if len(values) == 1 and name and name not in changed
    }


def _callbacks(
    tree: ast.Module, functions: dict[str, ast.FunctionDef | ast.AsyncFunctionDef]
) -> list[str]:
    """Return the functions that are given as callbacks, and those that they call."""
    waiting = [
        _target_name(argument)
        for call in calls(tree)
        if called(call) in TAKES_CALLBACKS
        for argument in (*call.args, *(each.value for each in call.keywords))
    ]
    found: list[str] = []
    while waiting:
        name = waiting.pop()
        if name in functions and name not in found:
            found.append(name)
            waiting += [called(call) for call in calls(functions[name])]
    return sorted(found)


def _clients(tree: ast.Module) -> set[str]:
    """Return the names, also those of `self`, that hold clients of services.

    Empty where the module has callback groups: with them a callback may wait for a service.
    """
    if any(called(call) in CALLBACK_GROUPS for call in calls(tree)):
        return set()
    return {
        _target_name(target)
        for node in ast.walk(tree)
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Call)
        if called(node.value) == "create_client"
        for target in node.targets
    }


def _target(call: ast.Call) -> str:
    """Return what the method is called of: `rclpy` of `rclpy.spin`."""
    return _target_name(call.func.value) if isinstance(call.func, ast.Attribute) else ""


def _target_name(node: ast.expr) -> str:
    """Return the last part of a dotted name."""
    match node:
        case ast.Name(id=name) | ast.Attribute(attr=name):
            return name
    return ""


def _argument(call: ast.Call, place: int, name: str) -> ast.expr | None:
    return call.args[place] if len(call.args) > place else keyword(call, name)
