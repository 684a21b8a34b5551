"""Times within a recording, as users type them."""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta

from robotctl.errors import UsageError
from robotctl.kernel.units import DAY_S, NS_PER_S

MAX_SECONDS = 366 * DAY_S


def is_offset(text: str) -> bool:
    """Return whether a time is given as seconds into a recording."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def parse_moment(text: str, start_ns: int, end_ns: int, option: str = "--at") -> int:
    """Return a time in a recording from `start_ns` to `end_ns`, as nanoseconds since the epoch.

    A time of day belongs to the day on which the recording begins, or to the next day if only that
    lies within the recording.

    Raises:
        UsageError: The text is not a time.
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
        f"{option} {text} is not a time",
        "give seconds into the recording, a time such as 12:03:04, "
        "or a date such as 2026-01-01T12:03:04",
    )


def _date_ns(text: str) -> int | None:
    try:
        return round(datetime.fromisoformat(text).astimezone().timestamp() * NS_PER_S)
    except (ValueError, OverflowError, OSError):
        return None


def parse_since(text: str, now_ns: int) -> int:
    """Return the moment that `--since` means, as nanoseconds since the epoch.

    Raises:
        UsageError: The text is neither a time span such as 30d, 12h or 15m, nor a date.
    """
    units_s = {"d": DAY_S, "h": 3_600.0, "m": 60.0, "s": 1.0}
    if text[-1:] in units_s and is_offset(text[:-1]):
        span_s = float(text[:-1]) * units_s[text[-1]]
        if math.isfinite(span_s) and span_s >= 0:
            return max(now_ns - round(span_s * NS_PER_S), 0)
    date_ns = None if is_offset(text) else _date_ns(text)
    if date_ns is None:
        raise UsageError(
            f"--since {text} is not a time", "give a span such as 30d, 12h or 15m, or 2026-01-31"
        )
    return date_ns
