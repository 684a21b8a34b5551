"""Foreign text in the log cannot imitate a log line."""

from __future__ import annotations

import logging
import sys

from robotctl.daemon.log.lines import PlainFormatter


def formatted(message: str, *arguments: object, failed: bool = False) -> str:
    error = None
    if failed:
        try:
            raise ValueError("why")
        except ValueError:
            error = sys.exc_info()
    record = logging.LogRecord("robotctl", logging.INFO, "", 1, message, arguments, error)
    return PlainFormatter("%(levelname)s: %(message)s").format(record)


def test_a_name_that_steers_a_terminal_is_escaped() -> None:
    assert formatted("topic %s", "/\x1b[2J\r\x07") == r"INFO: topic /\x1b[2J\r\x07"
    assert formatted("Größe %s", "µ") == "INFO: Größe µ"


def test_colours_of_others_are_left_out() -> None:
    assert formatted("%s", "\x1b[1;31mError\x1b[0m: no \x1b[m route") == "INFO: Error: no  route"


def test_a_name_cannot_look_like_an_entry() -> None:
    assert formatted("in %s", "a\nERROR: forged") == "INFO: in a\n    ERROR: forged"


def test_a_traceback_stays_readable() -> None:
    lines = formatted("it failed", failed=True).split("\n")
    assert lines[:2] == ["INFO: it failed", "Traceback (most recent call last):"]
    assert lines[-1] == "ValueError: why"
