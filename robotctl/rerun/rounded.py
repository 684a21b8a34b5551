"""Texts whose numbers can be compared over machines."""

from __future__ import annotations

import re
from typing import Final

DIGITS: Final = 9
"""The digits of a float that count: the last ones depend on Python and the C library."""

_FLOAT: Final = re.compile(r"-?\d+\.\d+(?:e[-+]?\d+)?")


def rounded(text: str) -> str:
    """Return a text with each float in it rounded."""
    return _FLOAT.sub(lambda number: f"{float(number[0]):.{DIGITS}g}", text)
