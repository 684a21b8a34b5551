"""Times as users type them, in a recording that begins before midnight and ends after it."""

from __future__ import annotations

from datetime import datetime

import pytest

from robotctl.base.errors import UsageError
from robotctl.cli.targets.recordings import parse_moment

START, END = "2026-01-01T23:50:00", "2026-01-02T00:20:00"


def ns(local_time: str) -> int:
    return round(datetime.fromisoformat(local_time).timestamp()) * 10**9


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("60", "2026-01-01T23:51:00"),
        ("23:55", "2026-01-01T23:55:00"),
        ("00:10:00", "2026-01-02T00:10:00"),
        ("00:20", END),
        ("00:21", "2026-01-01T00:21:00"),
        ("23:49:59", "2026-01-01T23:49:59"),
        ("2026-01-01T00:10", "2026-01-01T00:10:00"),
        ("2026-01-03", "2026-01-03T00:00:00"),
    ],
)
def test_a_time_of_day_is_that_of_the_next_day_only_where_the_recording_holds_it(
    text: str, meant: str
) -> None:
    assert parse_moment(text, ns(START), ns(END)) == ns(meant)


@pytest.mark.parametrize("text", ["noon", "", "25:00", "-1", "nan", "1e300", "2026-13-01"])
def test_what_is_no_time_is_a_usage_error(text: str) -> None:
    with pytest.raises(UsageError, match="give seconds into the recording"):
        parse_moment(text, ns(START), ns(END))
