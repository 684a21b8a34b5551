"""The numbers and topics of the kernel are those of docs/ros.md: default, limits and unit."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import pytest

from robotctl.kernel.parameters import kernel_leaves, value_at
from robotctl.kernel.params import KernelParams
from robotctl.kernel.patterns import SHAPES, Pattern

PAGE = (Path(__file__).parents[2] / "docs" / "ros.md").read_text()
DOCUMENTED = dict(re.findall(r"^\| `([\w.]+)` \| (\S* \| [^|]*?) \|", PAGE, re.MULTILINE))


def parameters(values: Any, prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield the key of each number, topic and frame, and the row that the page must have for it."""
    for field in fields(values):
        value = getattr(values, field.name)
        if is_dataclass(value):
            yield from parameters(value, f"{prefix}{field.name}.")
        elif "range" in field.metadata:
            allowed = field.metadata["range"]
            said = f"{value} | {allowed.low:g} to {allowed.high:g} {allowed.unit}".rstrip()
            yield f"{prefix}{field.name}", said
        elif field.metadata.get("topic"):
            none = '; "" for none' if field.metadata["optional"] else ""
            yield f"{prefix}{field.name}", f"{value} | a topic{none}"
        elif field.metadata.get("frame"):
            none = '; "" for any' if field.metadata["optional"] else ""
            yield f"{prefix}{field.name}", f"{value} | the name of a frame{none}"


PARAMETERS = dict(parameters(KernelParams()))


@pytest.mark.parametrize("key", PARAMETERS)
def test_a_parameter_is_as_the_page_says(key: str) -> None:
    assert DOCUMENTED[key] == PARAMETERS[key]


def test_every_parameter_is_on_the_page_or_is_a_choice_or_corners() -> None:
    assert {"rate_hz", "command.topic", "inputs.joy.button", "tracking.k_y"} <= set(PARAMETERS)
    params = KernelParams()
    others = {key: leaf for key, leaf in kernel_leaves().items() if key not in PARAMETERS}
    del others["fence.corners_m"]
    for key, leaf in others.items():
        assert isinstance(value_at(params, leaf.path), (Enum, bool)), key


def test_a_drive_without_a_size_fits_a_room() -> None:
    sizes_m = {kind.value: shape.default_size_m for kind, shape in SHAPES.items()}
    assert sizes_m == {
        "square": 1.0,
        "circle": 0.5,
        "figure-eight": 0.5,
        "rounded-square": 1.0,
        "line": 1.0,
        "arc": 0.5,
        "turn": 1.0,
    }


@pytest.mark.parametrize(
    ("pattern", "is_allowed"),
    [
        (Pattern(size_m=0.1), True),
        (Pattern(size_m=100.0), True),
        (Pattern(speed_mps=0.01), True),
        (Pattern(speed_mps=10.0), True),
        (Pattern(size_m=0.099), False),
        (Pattern(size_m=100.1), False),
        (Pattern(speed_mps=0.0099), False),
        (Pattern(speed_mps=10.1), False),
        (Pattern(size_m=float("nan")), False),
        (Pattern(speed_mps=float("nan")), False),
    ],
)
def test_a_pattern_is_refused_beyond_its_limits(pattern: Pattern, is_allowed: bool) -> None:
    assert (pattern.refusal() == "") is is_allowed
