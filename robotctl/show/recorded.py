"""A recording as its report shows it: read once, and its figures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from math import hypot, isfinite, sqrt
from pathlib import Path

from robotctl.errors import UnreadableFile
from robotctl.kernel.units import NS_PER_S
from robotctl.recording import Recording, RecordingInfo
from robotctl.recording.format.event_kind import EventKind
from robotctl.recording.format.ledger_record import read_ledger
from robotctl.recording.format.metadata_names import OWN_LIBRARY
from robotctl.recording.read.file_index import note_missing
from robotctl.recording.read.journal_reader import EntryDecoder, journal_topic
from robotctl.show.traces import JournalTraces, Traces, topic_traces
from robotctl.store.store_path import StorePath


@dataclass(frozen=True, slots=True)
class Recorded:
    """A recording as its report shows it.

    `drawn` are the topics that were drawn where there is no journal. `missing` says what could not
    be read. `is_live` means that it is being written, `is_cut_off` that robotctl never
    closed it.
    """

    info: RecordingInfo
    traces: Traces
    has_journal: bool
    drawn: tuple[str, ...]
    missing: tuple[str, ...]
    is_live: bool
    is_cut_off: bool


def read_recorded(
    path: Path, on_progress: Callable[[int, int], None] = lambda done, total: None
) -> Recorded:
    """Read a recording: a file or a folder, written by robotctl or by another recorder.

    From a store, only the topics that the report draws are read.

    Raises:
        UnreadableFile: Nothing can be read.
    """
    with Recording(path) as recording:
        info = recording.info()
        missing = list(recording.missing)

        def miss(sentence: str) -> None:
            note_missing(missing, sentence)

        traces = Traces(info.duration_s)
        journal, others = journal_topic(info), topic_traces(info.topics)
        for event in info.events:
            if journal is None or event.kind is EventKind.MARK:  # the journal tells the others
                t_s = (event.log_ns - info.start_ns) / NS_PER_S
                traces.happened(t_s, event.kind.value, event.text)
        from_journal, decoder = JournalTraces(traces), EntryDecoder(recording)
        drawn = set(others.topics) if journal is None else {journal}
        topics = drawn if isinstance(path, StorePath) else None
        for message in recording.in_order_written(topics, miss, on_progress):
            t_s = (message.log_ns - info.start_ns) / NS_PER_S
            traces.rates.add(message.topic, t_s)
            if journal is None:
                others.take(message, traces, t_s)
            elif message.topic == journal:
                try:
                    from_journal.take(decoder.decode(message.data), t_s)
                except UnreadableFile as error:
                    miss(str(error))
        traces.close()
        traces.moments.sort(key=lambda moment: moment.t_s)
        return Recorded(
            info=info,
            traces=traces,
            has_journal=journal is not None,
            drawn=() if journal is not None else tuple(others.topics),
            missing=tuple(missing),
            is_live=recording.is_live,
            is_cut_off=recording.is_cut_off and info.library.startswith(OWN_LIBRARY),
        )


@dataclass(frozen=True, slots=True)
class KeyFigure:
    """A figure: its key in `--json`, its name, its value (None: not known), format and unit.

    A value that is not finite is not known either: a recording may hold any number.
    """

    key: str
    name: str
    value: float | None
    form: str
    unit: str

    @property
    def text(self) -> str:
        """The value with its unit, or "unknown"."""
        if self.value is None:
            return "unknown"
        return f"{self.value:{self.form}} {self.unit}".rstrip()


def figures_of(recorded: Recorded) -> list[KeyFigure]:
    """Return the figures of a recording, in the order in which they are shown."""
    traces, info = recorded.traces, recorded.info
    ledger = read_ledger(info.metadata).values()
    lost = sum(counts.get("lost", 0) + counts.get("dropped", 0) for counts in ledger)
    rms_m, most_m = _cross_track(traces)
    drives = len(traces.drives) if recorded.has_journal else None
    fastest = _largest(traces.linear.least, traces.linear.most)
    figures = [
        KeyFigure("duration_s", "Duration", info.duration_s, ".1f", "s"),
        KeyFigure("drives", "Drives", drives, "d", ""),
        KeyFigure("distance_m", "Distance", _distance(traces), ".2f", "m"),
        KeyFigure("cross_track_rms_m", "Off track, RMS", rms_m, ".3f", "m"),
        KeyFigure("cross_track_max_m", "Off track, at most", most_m, ".3f", "m"),
        KeyFigure("speed_max_mps", "Speed, at most", fastest, ".2f", "m/s"),
        KeyFigure("battery_begin", "Battery, begin", _first(traces), ".1f", "%"),
        KeyFigure("battery_end", "Battery, end", _last(traces), ".1f", "%"),
        KeyFigure("tick_late_max_ms", "Tick late, at most", traces.lateness.most, ".1f", "ms"),
        KeyFigure("messages", "Messages", info.message_count, "d", ""),
        KeyFigure("lost", "Messages lost", lost if ledger else None, "d", ""),
    ]
    return [
        each if each.value is None or isfinite(each.value) else replace(each, value=None)
        for each in figures
    ]


def _distance(traces: Traces) -> float | None:
    if traces.drives:
        return sum(drive.report.distance_m for drive in traces.drives)
    places = traces.driven.whole()
    if not places:
        return None
    return sum(hypot(b.x - a.x, b.y - a.y) for a, b in pairwise(places))


def _cross_track(traces: Traces) -> tuple[float | None, float | None]:
    """Return the root mean square over all drives, by their duration, and the largest error."""
    reports = [
        report
        for report in (drive.report for drive in traces.drives)
        if isfinite(report.duration_s) and isfinite(report.cross_track_rms_m)
    ]
    time_s = sum(report.duration_s for report in reports)
    rms_m = None
    if time_s > 0.0:
        squares = (
            report.cross_track_rms_m * report.cross_track_rms_m * report.duration_s
            for report in reports
        )
        rms_m = sqrt(max(sum(squares) / time_s, 0.0))
    return rms_m, traces.error.most


def _largest(least: float | None, most: float | None) -> float | None:
    return None if least is None or most is None else max(abs(least), abs(most))


def _first(traces: Traces) -> float | None:
    columns = traces.battery.columns
    return columns[0].first if columns else None


def _last(traces: Traces) -> float | None:
    columns = traces.battery.columns
    return columns[-1].last if columns else None
