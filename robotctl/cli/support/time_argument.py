"""A time of a recording as people give it."""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta

from robotctl.errors import UsageError
from robotctl.kernel.units import NS_PER_S

MAX_SECONDS = 366 * 86_400.0


def is_offset(text: str) -> bool:
    """Whether a time is given as seconds into a recording."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def parse_moment(text: str, start_ns: int, end_ns: int) -> int:
    """Return nanoseconds since the epoch, in a recording from `start_ns` to `end_ns`.

    A time of day is that of the day on which the recording begins, or of the next day where it
    lies in the recording only then. Raises UsageError.
    """
    if is_offset(text):
        seconds = float(text)
        if math.isfinite(seconds) and 0 <= seconds <= MAX_SECONDS:
            return start_ns + round(seconds * NS_PER_S)
    else:
        first_day = datetime.fromtimestamp(start_ns // NS_PER_S, UTC).astimezone()
        same, next_ = (f"{first_day + timedelta(days=days):%Y-%m-%d}T{text}" for days in (0, 1))
        date_ns, same_ns, next_ns = map(_date_ns, (text, same, next_))
        if date_ns is not None:
            return date_ns
        if next_ns is not None and same_ns is not None:
            return next_ns if same_ns < start_ns and next_ns <= end_ns else same_ns
    raise UsageError(
        f"--at {text}",
        "give seconds into the recording, a time such as 12:03:04, "
        "or a date such as 2026-01-01T12:03:04",
    )


def _date_ns(text: str) -> int | None:
    try:
        return round(datetime.fromisoformat(text).astimezone().timestamp() * NS_PER_S)
    except (ValueError, OverflowError, OSError):
        return None
