"""What `status` tells about a shadow, as it stands in JSON."""

from __future__ import annotations

from typing import TypedDict


class DisagreementAnswer(TypedDict):
    """An event on which the driving kernel and the shadow decided differently."""

    ago_s: float
    event: str
    driving: str
    """What only the driving kernel decided, in words."""
    shadow: str
    """What only the shadow decided."""
    aspects: list[str]
    """mode, stop cause, command, answer; or wording, where only texts or figures differ."""


class ShadowFacts(TypedDict):
    """The kernel that decides beside the driving one, and commands nothing."""

    file: str
    digest: str
    """The beginning of the SHA-256 of its parameters."""
    failure: str
    """Why it is off, "" while it decides."""
    mode: str
    reason: str
    """Why it is in that mode."""
    steps: int
    slow_steps: int
    """The steps that took more than 25 ms; three in a row switch it off."""
    differing: int
    """The steps that it decided differently."""
    aspects: dict[str, int]
    """The number of differing steps by aspect."""
    apart_s: float | None
    """For how long its state has differed from the robot's, None while both are the same."""
    first: DisagreementAnswer | None
    last: DisagreementAnswer | None
