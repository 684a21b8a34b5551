"""The change of a parameter while the kernel runs: the request, and its effect."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ParameterRequested:
    """A request to change the parameter `key` from the text `old` to the text `new`.

    It gets one `Reply`. A float is written as its repr. The kernel knows its own parameters; the
    daemon has checked the values of all others.
    """

    t_ns: int
    request_id: int
    key: str
    old: str
    new: str
    source: str


@dataclass(frozen=True, slots=True)
class ParameterChanged:
    """A parameter has a new value from now on."""

    key: str
    old: str
    new: str
    source: str
