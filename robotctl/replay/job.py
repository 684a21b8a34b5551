"""The job that `robotctl replay` sends to the replay process, and checks of its options."""

from __future__ import annotations

import json
import re
from dataclasses import asdict, dataclass
from math import isfinite
from pathlib import Path
from typing import Any, Self

from robotctl.base.errors import UsageError

AS_FAST_AS_POSSIBLE = "max"
MAX_RATE = 10_000.0
MIN_RATE = 0.001
MIN_CLOCK_HZ = 0.1
MAX_CLOCK_HZ = 1000.0

_TOPIC_NAME = re.compile(r"/?[A-Za-z_]\w*(?:/[A-Za-z_]\w*)*", re.ASCII)


@dataclass(frozen=True, slots=True)
class Job:
    """What to play, and how.

    - `rate`: recorded seconds per second, or None for as fast as subscribers accept.
    - `topics`, `regex`: play each topic that one of them selects, or all if both are empty.
    - `exclude`: never play these topics.
    - `start_offset_s`, `duration_s`: the part to play, in recorded time after the first message.
    - `delay_s`: the real time before the first message.
    - `wait_for`: the number of subscriptions to wait for, over all topics.
    - `original_names`: play under the recorded names, even in a domain with a daemon.
    - `changed_types`: also play topics whose recorded type differs from the installed one.
    """

    file: Path
    domain_id: int
    rate: float | None = 1.0
    topics: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    regex: str = ""
    remaps: tuple[tuple[str, str], ...] = ()
    start_offset_s: float = 0.0
    duration_s: float | None = None
    delay_s: float = 0.0
    loop: bool = False
    paused: bool = False
    original_names: bool = False
    changed_types: bool = False
    clock_hz: float | None = None
    service_requests: bool = False
    wait_for: int = 0
    read_ahead: int | None = None
    debug: bool = False

    def to_json(self) -> str:
        """Return the job as one line of JSON."""
        return json.dumps(asdict(self) | {"file": str(self.file)})

    @classmethod
    def from_json(cls, line: str) -> Self:
        """Return the job in `line`, which `to_json` wrote."""
        fields: dict[str, Any] = json.loads(line)
        for name in ("topics", "exclude"):
            fields[name] = tuple(fields[name])
        fields["remaps"] = tuple((old, new) for old, new in fields["remaps"])
        return cls(**fields | {"file": Path(fields["file"])})


def parse_rate(text: str) -> float | None:
    """Return the rate in `text`, the value of `--rate`. None if `text` is `max`.

    Raises:
        UsageError: `text` is neither `max` nor a number from MIN_RATE to MAX_RATE.
    """
    if text.strip().lower() == AS_FAST_AS_POSSIBLE:
        return None
    try:
        rate = float(text)
    except ValueError:
        rate = 0.0
    if not MIN_RATE <= rate <= MAX_RATE:
        raise UsageError(
            f"--rate {text}: use a number from {MIN_RATE:g} to {MAX_RATE:g}, "
            f"or {AS_FAST_AS_POSSIBLE}"
        )
    return rate


def check_seconds(option: str, value: float, *, positive: bool = False) -> float:
    """Return `value` if it is an allowed duration [s] for the command-line option `option`.

    Raises:
        UsageError: `value` is negative or not finite, or is 0 although `positive` is true.
    """
    if not isfinite(value) or value < 0 or (positive and value == 0):
        raise UsageError(
            f"{option} {value:g}", f"give seconds, {'above' if positive else 'at least'} 0"
        )
    return value


def parse_remap(text: str) -> tuple[str, str]:
    """Return OLD and NEW of `text`, the value of `--remap OLD:=NEW`.

    Raises:
        UsageError: `text` is not of this form, or NEW is not a valid topic name.
    """
    old, sign, new = text.partition(":=")
    if not (sign and old and _TOPIC_NAME.fullmatch(new)):
        raise UsageError(
            f"--remap {text}: use OLD:=NEW with a new name like /robot/odom (letters, digits, _ "
            "and / between them, no digit first)"
        )
    return old, new


def check_regex(text: str) -> str:
    """Return `text` if it is a regular expression.

    Raises:
        UsageError: `text` is not a regular expression.
    """
    try:
        re.compile(text)
    except re.error as error:
        raise UsageError(f"--regex {text}: {error}") from None
    return text


def check_clock(hertz: float) -> float:
    """Return `hertz` if it is an allowed rate of `--clock`.

    Raises:
        UsageError: The rate is not allowed.
    """
    if not MIN_CLOCK_HZ <= hertz <= MAX_CLOCK_HZ:
        raise UsageError(f"--clock {hertz:g}", f"use {MIN_CLOCK_HZ:g} to {MAX_CLOCK_HZ:g} Hz")
    return hertz
