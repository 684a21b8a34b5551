"""From the name of an installed type to its class."""

from __future__ import annotations

from importlib import import_module
from typing import Any


def message_class(type_name: str) -> Any:
    """Return the class of `pkg/msg/T`; raises ImportError where it is not installed.

    Types that services and actions imply are found as well: `pkg/srv/T_Event`,
    `pkg/action/T_FeedbackMessage`, `pkg/action/T_SendGoal_Event`.
    """
    try:
        package, kind, short = type_name.split("/")
    except ValueError:
        raise ImportError(f"{type_name!r} is not the name of a type") from None
    module = import_module(f"{package}.{kind}")
    interface = getattr(module, interface_of(short), None)
    if interface is not None:  # what it implies is defined beside it, and not always exported
        module = import_module(interface.__module__)
    if not hasattr(module, short):
        raise ImportError(f"{package} has no {kind} {short}")
    return getattr(module, short)


def interface_of(short: str) -> str:
    """Return T of `T_Event` and the like; an interface's own name has no underscore."""
    return short.partition("_")[0]
