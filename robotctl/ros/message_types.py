"""From the name of an installed type to its class."""

from __future__ import annotations

from importlib import import_module
from typing import Any


def message_class(type_name: str) -> Any:
    """Return the class of `pkg/msg/T`; raises ImportError where it is not installed.

    Types that services and actions imply are found as well: `pkg/srv/T_Event`,
    `pkg/action/T_FeedbackMessage`.
    """
    try:
        package, kind, short = type_name.split("/")
    except ValueError:
        raise ImportError(f"{type_name!r} is not the name of a type") from None
    module = import_module(f"{package}.{kind}")
    if hasattr(module, short):
        return getattr(module, short)
    outer, _, inner = short.rpartition("_")
    parent = getattr(module, outer, None)
    for holder in (parent, getattr(parent, "Impl", None)):
        if hasattr(holder, inner):
            return getattr(holder, inner)
    raise ImportError(f"{package} has no {kind} {short}")
