"""The page of one recording: it needs no network, and is complete without its script."""

from __future__ import annotations

import base64
import hashlib
import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Final

from robotctl import __version__
from robotctl.kernel.units import NS_PER_S
from robotctl.show.markup import Content, Markup, joined, tag
from robotctl.show.page_plots import cursor_data, path_plot, time_plots
from robotctl.show.recorded import KeyFigure, Recorded, figures_of
from robotctl.show.tables import (
    drives_table,
    messages_table,
    modes_table,
    moments_table,
    parameters_table,
    provenance_table,
)
from robotctl.show.traces import Traces


class Tone(StrEnum):
    """What a verdict means for a reader."""

    GOOD = "good"
    UNSURE = "unsure"
    """Nothing is wrong, but not everything is proved."""

    BAD = "bad"


@dataclass(frozen=True, slots=True)
class CommandVerdict:
    """A verdict: by which command, the verdict in a word, what it means, and its sentences."""

    command: str
    verdict: str
    tone: Tone
    sentences: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Explanation:
    """Why the robot was stopped, or why something was refused: rows of a label and a sentence."""

    t_s: float
    what: str
    rows: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class ReportFindings:
    """All that was found."""

    judgements: tuple[CommandVerdict, ...] = ()
    explanations: tuple[Explanation, ...] = ()


_FOLDER: Final = Path(__file__).parent


def report_page(recorded: Recorded, judged: ReportFindings) -> str:
    """Return the page of a recording."""
    name = recorded.info.path.resolve().name
    body = joined(
        _header(recorded, judged.judgements),
        _notes(recorded),
        _figures(figures_of(recorded)),
        *_sections(recorded, judged),
        _footer(),
    )
    return _document(f"{name}: robotctl report", body, cursor_data(recorded.traces))


def _document(title: str, body: Markup, data: dict[str, object]) -> str:
    """Return a whole page; its policy lets nothing but its own script and style take effect."""
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
    began = time.strftime("%Y-%m-%d %H:%M:%S %z", time.localtime(_seconds(info.start_ns)))
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


def _seconds(time_ns: int) -> int:
    """Return a time that the calendar knows; a file may hold any number."""
    return min(time_ns // NS_PER_S, 253_402_300_799)


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
    yield _section("time", "Over time", *_time_plots(traces))
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


def _time_plots(traces: Traces) -> Iterator[Content]:
    yield from time_plots(traces)
    odd = sum(series.odd for series in traces.series())
    if odd:
        yield tag("p", f"{odd} values are not drawn: no numbers, or impossible.", class_="note")


def _explanation(why: Explanation) -> Markup:
    rows = [tag("div", tag("dt", label), tag("dd", text)) for label, text in why.rows]
    moment = tag("a", f"{why.t_s:.3f} s", href="#time", data_t=f"{why.t_s:.4f}")
    return tag("article", tag("h3", moment, "  ", why.what), tag("dl", *rows, class_="why"))


def _judgement(each: CommandVerdict) -> Markup:
    badge = tag("span", each.verdict, class_=f"badge {each.tone.value}")
    sentences = tag("ul", *(tag("li", sentence) for sentence in each.sentences))
    head = tag("h3", tag("code", f"robotctl {each.command}"), " ", badge)
    return tag("article", head, sentences if each.sentences else None)


def _footer() -> Markup:
    return tag("footer", tag("p", f"Made by robotctl {__version__} from the recording alone."))
