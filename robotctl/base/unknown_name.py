"""Error texts for names that are neither on ROS nor in a recording."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from difflib import get_close_matches

from robotctl.base.errors import UsageError
from robotctl.base.text import printable, short_name


def unknown_name(kind: str, name: str, known: Iterable[str]) -> tuple[str, str]:
    """Return cause and cure of the error for a topic, node or service that is not in `known`."""
    names = sorted(each for each in known if "/_" not in each)
    near = get_close_matches(name, names, n=1) or [
        each for each in names if each.endswith(name) or name.endswith(each)
    ]
    cure = f"did you mean {short_name(near[0])}?" if near else f"see: robotctl {kind} list"
    return f"no {kind} {short_name(name)}", cure


def only_type(name: str, types: Collection[str]) -> str:
    """Return the only item of `types`, the types that the topic `name` has.

    Raises:
        UsageError: The topic has several types.
    """
    if len(types) == 1:
        return next(iter(types))
    shown = sorted(map(printable, types))
    raise UsageError(
        f"{name} has several types: {', '.join(shown)}", f"choose one: --type {shown[0]}"
    )
