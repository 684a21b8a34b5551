"""Velocities of viewers: only what a Twist in JSON can say, and this robot can do."""

from __future__ import annotations

import pytest

from robotctl.view.foxglove_requests import WrongRequest
from robotctl.view.remote_control import velocity_of


def test_a_twist_is_two_numbers() -> None:
    full = b'{"linear": {"x": 0.5, "y": 0, "z": 0.0}, "angular": {"x": 0, "y": 0, "z": -1}}'
    assert velocity_of(full) == (0.5, -1.0)
    assert velocity_of(b'{"linear": {"x": 0.5}, "angular": {"z": 0}}') == (0.5, 0.0)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"[]",
        b'{"linear": {"x": NaN}, "angular": {"z": 0}}',
        b'{"linear": {"x": 1e999}, "angular": {"z": 0}}',
        b'{"linear": {"x": 1, "y": 0.1}, "angular": {"z": 0}}',
        b'{"linear": {"x": 1}, "angular": {"x": 1, "z": 0}}',
        b'{"linear": {"x": "fast"}, "angular": {"z": 0}}',
        b'{"linear": 3, "angular": {"z": 0}}',
        b'{"linear": {"x": 1}}',
        b'{"linear": {"x": ' + b"9" * 400 + b'}, "angular": {"z": 0}}',
    ],
)
def test_anything_else_is_refused(data: bytes) -> None:
    with pytest.raises(WrongRequest):
        velocity_of(data)
