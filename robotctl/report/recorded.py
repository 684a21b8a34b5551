"""Reads a recording once for its report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from robotctl.errors import UnreadableFile
from robotctl.kernel.units import NS_PER_S
from robotctl.recording import Recording, RecordingInfo
from robotctl.recording.format.event_kind import EventKind
from robotctl.recording.format.metadata_names import OWN_LIBRARY
from robotctl.recording.read.file_index import note_missing
from robotctl.recording.read.journal_reader import EntryDecoder, journal_topic
from robotctl.report.journal_traces import JournalTraces
from robotctl.report.topic_traces import topic_traces
from robotctl.report.traces import Traces
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
