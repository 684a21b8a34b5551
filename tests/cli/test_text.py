"""Text from files and daemons is shown without control sequences."""

from __future__ import annotations

import fcntl
import os
import pty
import struct
import sys
import termios
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotctl.cli.ui.text import (
    UNLIMITED,
    columns,
    duration,
    elided,
    json_text,
    number,
    printable,
    row,
    short_path,
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


def test_a_long_name_is_cut_in_the_middle() -> None:
    assert elided("/a/very/long/topic/name", 12) == "/a/ve../name"
    assert elided("/short", 12) == "/short"
    assert len(elided("\x1b" * 20, 11)) == 11


def test_a_path_below_the_working_directory_is_relative(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert short_path(tmp_path / "recordings" / "run") == "recordings/run"
    assert short_path(tmp_path.parent) == str(tmp_path.parent)
    assert short_path("/bin/\x07") == "/bin/\\x07"


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


def test_a_number_that_is_not_there_is_unknown() -> None:
    assert number(None, ".3f") == "unknown"
    assert number("nan", ".3f") == "unknown"
    assert number(1, ".3f") == "1.000"


@pytest.mark.parametrize(("of_the_terminal", "taken"), [(60, 60), (200, 80), (0, 80)])
def test_a_line_is_as_wide_as_the_terminal_and_at_most_80_columns(
    of_the_terminal: int, taken: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    controller, terminal = pty.openpty()
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 24, of_the_terminal, 0, 0))
    with os.fdopen(terminal, "w") as stdout:
        monkeypatch.setattr(sys, "stdout", stdout)
        assert columns() == taken
        monkeypatch.undo()
    os.close(controller)
    assert columns() == UNLIMITED


@pytest.mark.usefixtures("wide_terminal")
def test_long_text_is_wrapped_beside_its_label() -> None:
    assert list(row("  reason  ", "word " * 20)) == [
        "  reason  " + "word " * 13 + "word",
        "          " + "word " * 5 + "word",
    ]
    assert list(row("  reason  ", "")) == ["  reason  "]
