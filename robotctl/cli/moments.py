"""A time of a recording as people give it."""

from __future__ import annotations

import math
import time
from datetime import datetime

from robotctl.errors import UsageError

MAX_SECONDS = 366 * 86_400.0


def parse_moment(text: str, start_ns: int) -> int:
    """Nanoseconds since the epoch, in a recording that begins at `start_ns`. Raises UsageError."""
    try:
        seconds = float(text)
        if math.isfinite(seconds) and 0 <= seconds <= MAX_SECONDS:
            return start_ns + round(seconds * 1e9)
    except ValueError:
        day = time.strftime("%Y-%m-%d", time.localtime(start_ns // 10**9))
        for candidate in (text, f"{day}T{text}"):
            try:
                return round(datetime.fromisoformat(candidate).astimezone().timestamp() * 1e9)
            except (ValueError, OverflowError, OSError):
                continue
    raise UsageError(
        f"--at {text}",
        "give seconds into the recording, a time such as 12:03:04, "
        "or a date such as 2026-01-01T12:03:04",
    )
