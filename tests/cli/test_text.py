"""Text from files and daemons is shown without control sequences."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotctl.cli.ui.text import (
    duration,
    json_text,
    printable,
    size,
)


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("/cmd_vel", "/cmd_vel"),
        ("\u00fcber \U0001f916", "\u00fcber \U0001f916"),
        ("\x1b[2J", "\\x1b[2J"),
        ("a\nb\tc", "a\\nb\\tc"),
        ("\x9b31m", "\\x9b31m"),
        ("\u202eevil", "\\u202eevil"),
        ("\udc80", "\\udc80"),
        (None, "None"),
    ],
)
def test_what_is_not_printable_is_shown_escaped(text: object, shown: str) -> None:
    assert printable(text) == shown


@given(st.text())
def test_nothing_unprintable_gets_through(text: str) -> None:
    assert printable(text).isprintable()
    assert json_text({"name": text}).isascii()


@pytest.mark.parametrize(
    ("count", "text"),
    [(0, "0 B"), (999, "999 B"), (1868, "1.9 kB"), (5e7, "50.0 MB"), (3e9, "3.0 GB")],
)
def test_bytes_are_shown_in_powers_of_ten(count: float, text: str) -> None:
    assert size(count) == text


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.04, "0.0 s"), (59.9, "59.9 s"), (61, "1 min 1 s"), (7260, "2 h 1 min")]
)
def test_a_duration_is_shown_in_two_units(seconds: float, text: str) -> None:
    assert duration(seconds) == text
