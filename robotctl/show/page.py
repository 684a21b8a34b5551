"""The HTML page of one recording, which works without network and script."""

from __future__ import annotations

import base64
import hashlib
import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import isfinite
from pathlib import Path
from typing import Final

from robotctl import __version__
from robotctl.kernel.constants import NS_PER_S
from robotctl.recording import TopicInfo
from robotctl.recording.format.names import INFO_RECORD, PARAMETER_PREFIX
from robotctl.recording.format.topics import read_ledger
from robotctl.show.page_plots import cursor_data, path_plot, time_plots
from robotctl.show.svg import Content, Markup, joined, plain, tag
from robotctl.show.traces import (
    EndedDrive,
    KeyFigure,
    ModeSpan,
    Recorded,
    TracedMoment,
    figures_of,
)

MAX_ROWS: Final = 300
MAX_TABLE_CHARACTERS: Final = 75_000
"""The limits of a table."""

MAX_NAMES: Final = 100

RATE_WIDTH, RATE_HEIGHT = 120, 18


def table(heads: Sequence[str], rows: Sequence[Sequence[Content]]) -> Markup:
    """Return a table of `rows`, with a note on the number of rows left out."""
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
    """Return the table of the drives with their key figures."""
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
    """Return a table of what happened and when, with links into the plots."""
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
    """Return the table of the modes with begin, duration and reason."""
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
    """Return the table of the topics with rates and losses, and a list of the silent topics."""
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
    """Return a small picture of the message rate over time, None without messages."""
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
    """Return a table with the origin of the recording."""
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
    """Return a table of the parameters at the start of the last file, None if there are none."""
    told = recorded.info.metadata.get(INFO_RECORD, {})
    rows = [
        (key.removeprefix(PARAMETER_PREFIX), value)
        for key, value in told.items()
        if key.startswith(PARAMETER_PREFIX)
    ]
    return table(("Parameter", "Value"), rows) if rows else None


def _number(value: float, unit: str) -> str:
    return f"{value:.3f} {unit}" if isfinite(value) else ""


class Tone(StrEnum):
    """Whether a verdict on a recording is good, bad or undecided, for the page's colours."""

    GOOD = "good"
    UNSURE = "unsure"
    """Nothing is wrong, but not everything is proved."""

    BAD = "bad"


@dataclass(frozen=True, slots=True)
class CommandVerdict:
    """The verdict of a command such as `verify` on a recording, with explaining sentences."""

    command: str
    verdict: str
    tone: Tone
    sentences: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Explanation:
    """The reasons for a stop or a refusal at `t_s`, as rows of a label and a sentence."""

    t_s: float
    what: str
    rows: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class ReportFindings:
    """The verdicts and explanations that a report shows."""

    judgements: tuple[CommandVerdict, ...] = ()
    explanations: tuple[Explanation, ...] = ()


_FOLDER: Final = Path(__file__).parent


def report_page(recorded: Recorded, judged: ReportFindings) -> str:
    """Return the HTML page of a recording, with the verdicts and explanations in `judged`."""
    name = recorded.info.path.resolve().name
    body = joined(
        _header(recorded, judged.judgements),
        _notes(recorded),
        _figures(figures_of(recorded)),
        *_sections(recorded, judged),
        tag("footer", tag("p", f"Made by robotctl {__version__} from the recording alone.")),
    )
    return _document(f"{name}: robotctl report", body, cursor_data(recorded.traces))


def _document(title: str, body: Markup, data: dict[str, object]) -> str:
    """Return a whole page, whose policy allows only its own script and style."""
    style, script = (_FOLDER.joinpath(name).read_text("utf-8") for name in ("page.css", "page.js"))
    policy = (
        f"default-src 'none'; style-src '{_digest(style)}'; script-src '{_digest(script)}'; "
        "base-uri 'none'; form-action 'none'"
    )
    # Only `<` could end the element early.
    numbers = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
    head = tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", http_equiv="Content-Security-Policy", content=Markup(policy)),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("meta", name="color-scheme", content="light dark"),
        tag("title", title),
        tag("style", Markup(style)),
    )
    scripts = joined(
        tag("script", Markup(numbers), type="application/json", id="data"),
        tag("script", Markup(script)),
    )
    whole = tag("html", head, tag("body", tag("main", body), scripts), lang="en")
    return f"<!doctype html>\n{whole}\n"


def _section(name: str, title: str, *content: Content) -> Markup:
    return tag("section", tag("h2", title), *content, id=name)


def _digest(text: str) -> str:
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"


def _header(recorded: Recorded, judgements: Sequence[CommandVerdict]) -> Markup:
    info = recorded.info
    start_s = min(info.start_ns // NS_PER_S, 253_402_300_799)  # a file may contain any number
    began = time.strftime("%Y-%m-%d %H:%M:%S %z", time.localtime(start_s))
    badges = [
        tag(
            "a",
            f"{each.command}: {each.verdict}",
            href="#verdicts",
            class_=f"badge {each.tone.value}",
        )
        for each in judgements
    ]
    return tag(
        "header",
        tag("p", "robotctl report", class_="product"),
        tag("h1", info.path.resolve().name),
        tag("p", f"{began}, {info.duration_s:.1f} s", class_="when") if info.message_count else "",
        tag("p", *badges, class_="badges"),
    )


def _notes(recorded: Recorded) -> Markup | None:
    notes = []
    if recorded.is_live:
        notes.append("This recording is being written: the report shows what it held until now.")
    if recorded.is_cut_off:
        notes.append("This recording was never closed: the daemon was killed, or recording failed.")
    if not recorded.has_journal:
        drawn = ", ".join(recorded.drawn) or "no topic that can be drawn"
        notes.append(
            f"There is no journal of robotctl in it. Drawn: {drawn}. Wanted path, error, modes, "
            "ticks and reasons are not known."
        )
    notes += [f"Not read: {sentence}" for sentence in recorded.missing]
    if recorded.traces.left_out:
        notes.append(
            f"{recorded.traces.left_out} more modes, moments, drives or wanted paths are not shown."
        )
    return tag("ul", *(tag("li", note) for note in notes), class_="notes") if notes else None


def _figures(figures: Sequence[KeyFigure]) -> Markup:
    return tag(
        "dl",
        *(
            tag("div", tag("dt", each.name), tag("dd", each.text), id=f"figure-{each.key}")
            for each in figures
        ),
        class_="figures",
    )


def _sections(recorded: Recorded, judged: ReportFindings) -> Iterator[Content]:
    traces = recorded.traces
    path = path_plot(traces)
    if path is not None:
        yield _section("path", "Path", path)
    odd = sum(series.odd for series in traces.series())
    note = tag("p", f"{odd} values are not drawn: no numbers, or impossible.", class_="note")
    yield _section("time", "Over time", *time_plots(traces), note if odd else None)
    if traces.moments:
        yield _section("moments", "What happened", moments_table(traces.moments))
    if judged.explanations:
        yield _section("why", "Why", *map(_explanation, judged.explanations))
    if traces.drives:
        yield _section("drives", "Drives", drives_table(traces.drives))
    if traces.modes:
        yield _section("modes", "Modes", modes_table(traces.modes))
    if judged.judgements:
        yield _section("verdicts", "Verdicts", *map(_judgement, judged.judgements))
    yield _section("messages", "Messages", messages_table(recorded))
    yield _section("provenance", "Provenance", provenance_table(recorded))
    parameters = parameters_table(recorded)
    if parameters is not None:
        folded = tag("details", tag("summary", "Parameters of the last file"), parameters)
        yield _section("parameters", "Parameters", folded)


def _explanation(why: Explanation) -> Markup:
    rows = [tag("div", tag("dt", label), tag("dd", text)) for label, text in why.rows]
    moment = tag("a", f"{why.t_s:.3f} s", href="#time", data_t=f"{why.t_s:.4f}")
    return tag("article", tag("h3", moment, "  ", why.what), tag("dl", *rows, class_="why"))


def _judgement(each: CommandVerdict) -> Markup:
    badge = tag("span", each.verdict, class_=f"badge {each.tone.value}")
    sentences = tag("ul", *(tag("li", sentence) for sentence in each.sentences))
    head = tag("h3", tag("code", f"robotctl {each.command}"), " ", badge)
    return tag("article", head, sentences if each.sentences else None)
