"""The tables of a report."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import Final

from robotctl.recording import TopicInfo
from robotctl.recording.format.ledger_record import read_ledger
from robotctl.recording.format.metadata_names import INFO_RECORD, PARAMETER_PREFIX
from robotctl.show.markup import Content, Markup, joined, plain, tag
from robotctl.show.recorded import Recorded
from robotctl.show.traces import EndedDrive, ModeSpan, TracedMoment

MAX_ROWS: Final = 300
MAX_TABLE_CHARACTERS: Final = 75_000
"""The limits of a table; a recording may hold any number of topics and parameters."""

MAX_NAMES: Final = 100

RATE_WIDTH, RATE_HEIGHT = 120, 18


def table(heads: Sequence[str], rows: Sequence[Sequence[Content]]) -> Markup:
    """Return a table, and a line that tells how many rows are beyond its limits."""
    body: list[Markup] = []
    characters = 0
    for row in rows[:MAX_ROWS]:
        made = tag("tr", *(tag("td", cell) for cell in row))
        characters += len(made)
        if characters > MAX_TABLE_CHARACTERS:
            break
        body.append(made)
    head = tag("thead", tag("tr", *(tag("th", text, scope="col") for text in heads)))
    whole = tag("div", tag("table", head, tag("tbody", *body)), class_="scroll")
    more = len(rows) - len(body)
    return joined(whole, tag("p", f"and {more} more", class_="note") if more else None)


def drives_table(drives: Sequence[EndedDrive]) -> Markup:
    """Return the drives with their figures."""
    heads = ("End", "Laps", "Distance", "Duration", "Off track RMS", "at most", "Closure", "Ended")
    rows = [
        (
            f"{drive.t_s:.2f} s",
            drive.report.laps,
            _number(drive.report.distance_m, "m"),
            _number(drive.report.duration_s, "s"),
            _number(drive.report.cross_track_rms_m, "m"),
            _number(drive.report.cross_track_max_m, "m"),
            _number(drive.report.closure_m, "m"),
            drive.reason,
        )
        for drive in drives
    ]
    return table(heads, rows)


def moments_table(moments: Sequence[TracedMoment]) -> Markup:
    """Return what happened; each row is a link to its place in the plots."""
    rows = [
        (
            tag("span", str(number), class_="number"),
            tag(
                "a",
                f"{moment.t_s:.3f} s",
                href=f"#moment-{number}",
                data_t=f"{moment.t_s:.4f}",
            ),
            moment.kind,
            moment.text,
        )
        for number, moment in enumerate(moments, 1)
    ]
    return table(("", "Moment", "Kind", "What"), rows)


def modes_table(spans: Sequence[ModeSpan]) -> Markup:
    """Return the modes with their reasons."""
    rows = [
        (
            f"{span.begin_s:.2f} s",
            f"{span.end_s - span.begin_s:.2f} s",
            span.mode.replace("_", " "),
            span.reason,
        )
        for span in spans
    ]
    return table(("From", "For", "Mode", "Why"), rows)


def messages_table(recorded: Recorded) -> Markup:
    """Return the topics with their rates and losses, and the names of those without messages."""
    ledger = read_ledger(recorded.info.metadata)
    heads = ("Topic", "Messages", "Rate", "Over time", "Longest pause", "Lost", "Dropped")
    topics = recorded.info.topics
    heard = [topic for topic in topics if topic.message_count]
    silent = [topic.name for topic in topics if not topic.message_count]
    named = [joined(tag("span", name), " ") for name in silent[:MAX_NAMES]]
    more = f"and {len(silent) - MAX_NAMES} more" if len(silent) > MAX_NAMES else None
    note = tag("p", f"{len(silent)} topics without messages: ", *named, more, class_="note")
    made = table(heads, [_topic_row(topic, ledger, recorded) for topic in heard])
    return joined(made, note if silent else None)


def _topic_row(
    topic: TopicInfo, ledger: dict[str, dict[str, int]], recorded: Recorded
) -> Sequence[Content]:
    rates, counts = recorded.traces.rates, ledger.get(topic.name, {})
    pause_s = rates.pauses_s.get(topic.name)
    return (
        joined(topic.name, tag("br"), tag("small", topic.type_name)),
        topic.message_count,
        f"{topic.rate_hz:.1f} Hz",
        rate_picture(rates.counts.get(topic.name, ())),
        f"{pause_s:.2f} s" if pause_s is not None and topic.message_count > 1 else "",
        counts.get("lost", "not known"),
        counts.get("dropped", "not known"),
    )


def rate_picture(counts: Sequence[int]) -> Markup | None:
    """Return a small picture of how many messages came over time."""
    most = max(counts, default=0)
    if not most:
        return None
    step = RATE_WIDTH / len(counts)
    tops = [plain(RATE_HEIGHT - (RATE_HEIGHT - 1) * count / most) for count in counts]
    steps = "".join(f"V{top}h{plain(step)}" for top in tops)
    return tag(
        "svg",
        tag("path", d=Markup(f"M0 {RATE_HEIGHT}{steps}V{RATE_HEIGHT}z"), class_="rate"),
        viewBox=f"0 0 {RATE_WIDTH} {RATE_HEIGHT}",
        class_="rates",
        role="img",
        aria_label="messages over time",
    )


def provenance_table(recorded: Recorded) -> Markup:
    """Return what made the recording."""
    info = recorded.info
    told = info.metadata.get(INFO_RECORD, {})
    known = {
        key: value for key, value in told.items() if not key.startswith(PARAMETER_PREFIX) and value
    }
    own = {
        "files": ", ".join(path.name for path in info.files),
        "writer": info.library,
        "profile": info.profile,
    }
    return table(("What", "Value"), list((own | known).items()))


def parameters_table(recorded: Recorded) -> Markup | None:
    """Return the parameters that the robot had when the last file began, None if not known."""
    told = recorded.info.metadata.get(INFO_RECORD, {})
    rows = [
        (key.removeprefix(PARAMETER_PREFIX), value)
        for key, value in told.items()
        if key.startswith(PARAMETER_PREFIX)
    ]
    return table(("Parameter", "Value"), rows) if rows else None


def _number(value: float, unit: str) -> str:
    return f"{value:.3f} {unit}" if isfinite(value) else ""
