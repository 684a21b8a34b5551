"""The kinds of input that a check compares, and what their events tell."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from operator import attrgetter
from typing import Any, NamedTuple

from robotctl.cdr.motion import Sample, sample_of
from robotctl.kernel.types import (
    BatteryReceived,
    Event,
    GuardedCommandReceived,
    OdomReceived,
    ScanReceived,
)


class InputKind(NamedTuple):
    """A kind of input, such as odometry: its name for people and the class of its events.

    `source` returns which publisher an event is from, `value` what was measured.
    """

    name: str
    event: type[Event]
    source: Callable[[Event], Hashable]
    value: Callable[[Event], Any]


def _sample(event: Event) -> Sample:
    assert isinstance(event, OdomReceived)
    return sample_of(event.odometry)


sequence_of: Callable[[Event], int] = attrgetter("sequence")
_SOURCE, _PUBLISHER = attrgetter("source"), attrgetter("publisher")

ODOMETRY = InputKind("odometry", OdomReceived, _SOURCE, _sample)
BATTERY = InputKind("the battery", BatteryReceived, _PUBLISHER, attrgetter("level"))
SCAN = InputKind("the scan", ScanReceived, _PUBLISHER, attrgetter("sectors"))
WANTED = InputKind("the wanted velocity", GuardedCommandReceived, _PUBLISHER, attrgetter("twist"))
