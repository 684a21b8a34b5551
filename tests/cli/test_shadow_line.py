"""The line of `robotctl status` about a shadow."""

from __future__ import annotations

from typing import Any

import pytest

from robotctl.cli.terminal.status_screen import shadow_text

ASPECTS = {"mode": 0, "stop cause": 0, "command": 0, "answer": 0, "wording": 0}
SAME: dict[str, Any] = {
    "failure": "",
    "mode": "IDLE",
    "reason": "started",
    "steps": 12,
    "differing": 0,
    "aspects": ASPECTS,
    "apart_s": None,
    "last": None,
}
LAST = {"ago_s": 0.5, "shadow": "0.100 m/s, 0.000 rad/s", "driving": "0.600 m/s, 0.000 rad/s"}
DIFFERS = {"differing": 3, "aspects": {**ASPECTS, "mode": 1, "command": 2}, "last": LAST}
TOLD = "differs in 3 of 12 steps (1 mode, 2 command)"
END = "; last 0.5 s ago: 0.100 m/s, 0.000 rad/s instead of 0.600 m/s, 0.000 rad/s"


@pytest.mark.parametrize(
    ("facts", "says"),
    [
        ({}, "decides the same in 12 steps"),
        ({"failure": "slow"}, "off; until then: decides the same in 12 steps"),
        (DIFFERS, f"{TOLD}{END}"),
        (
            {**DIFFERS, "apart_s": 2.0, "mode": "ERROR", "reason": "too far"},
            f"{TOLD}; apart for 2.0 s: ERROR, too far{END}",
        ),
    ],
)
def test_it_tells_how_often_and_how_it_decided_otherwise(facts: dict[str, Any], says: str) -> None:
    assert shadow_text(SAME | facts) == says
