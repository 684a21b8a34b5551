"""info: show the contents of a recording."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from robotctl.base.errors import UnreadableFile
from robotctl.cli.options import Json, new_app
from robotctl.cli.targets.recordings import (
    RecordedBy,
    RecordingsFolder,
    cure_of_damage,
    find_recording,
)
from robotctl.cli.ui.output import print_answer
from robotctl.cli.ui.status import TopicLines
from robotctl.cli.ui.text import duration, moment, printable, short_path, size

if TYPE_CHECKING:
    from robotctl.recording import RecordingInfo
    from robotctl.recording.format.recorded_events import RecordedEvent

app = new_app()

MAX_EVENTS_SHOWN = 20

_POLICIES = {
    "reliability": {"1": "reliable", "2": "best_effort"},
    "durability": {"1": "transient_local", "2": "volatile"},
    "history": {"1": "keep_last", "2": "keep_all", "3": "unknown"},
}
"""The names of the numbers that rosbag2 wrote before version 9 of its metadata (rmw/types.h). The
history is unknown if DDS did not report it to the recorder."""

_ENTRY = re.compile(r"^ *(reliability|durability|history|depth): *(\w+)", re.MULTILINE)


@app.command()
def info(
    file: Annotated[
        str,
        typer.Argument(
            metavar="FILE", help="An MCAP file, a recording's folder or name, a URL, or `last`."
        ),
    ],
    folder: RecordingsFolder = None,
    robot: RecordedBy = None,
    as_json: Json = False,
) -> None:
    """Show topics, counts, rates, QoS and events of a recording.

    Reads any MCAP file. For a damaged one it shows what can be read, names what is missing, and
    exits with code 6.

    \b
    Examples:
      robotctl info last
      robotctl info recordings/robot_20260101_120000
      robotctl info s3://bucket/robots/run.mcap
      robotctl info run.mcap --json | jq '.topics[].name'
    """
    from robotctl.recording import read_info

    path = find_recording(file, robot, folder, also_url=True)
    found = read_info(path)
    error = None
    if found.missing:
        error = UnreadableFile(
            f"{path} is incomplete: {'; '.join(found.missing)}",
            cure_of_damage(path),
        )
    print_answer(as_object(found), info_lines(found), as_json=as_json, error=error)


def as_object(found: RecordingInfo) -> dict[str, Any]:
    """Return the object for `info --json`. Suffixes of keys are units; `_ns` is since the epoch."""
    from robotctl.recording.format.names import EVENT_RECORD, LEDGER_RECORD, EventKind
    from robotctl.recording.format.rosbag2 import METADATA_RECORD
    from robotctl.recording.format.topics import read_ledger

    shown_elsewhere = (METADATA_RECORD, LEDGER_RECORD, EVENT_RECORD)
    return {
        "path": str(found.path),
        "files": [str(path) for path in found.files],
        "size_bytes": found.size_bytes,
        "start_ns": found.start_ns,
        "end_ns": found.end_ns,
        "duration_s": found.duration_s,
        "messages": found.message_count,
        "profile": found.profile,
        "library": found.library,
        "topics": [
            {
                "name": topic.name,
                "type": topic.type_name,
                "count": topic.message_count,
                "rate": topic.rate_hz,
                "encoding": topic.encoding,
                "qos": qos_text(topic.offered_qos),
                "type_hash": topic.type_hash,
            }
            for topic in found.topics
        ],
        "events": [
            {"kind": event.kind.value, "time_ns": event.log_ns, "text": event.text}
            | ({"laps": event.laps} if event.kind is EventKind.DRIVE_ENDED else {})
            for event in found.events
        ],
        "ledger": read_ledger(found.metadata),
        "metadata": {
            name: values for name, values in found.metadata.items() if name not in shown_elsewhere
        },
        "missing": list(found.missing),
    }


def info_lines(found: RecordingInfo) -> Iterator[str]:
    """Yield the lines of `robotctl info`."""
    count = len(found.files)
    files = "" if count == 1 else f" in {count} files"
    yield short_path(found.path)
    yield f"  size       {size(found.size_bytes)}{files}"
    if found.message_count:
        yield f"  start      {moment(found.start_ns)}"
        yield f"  duration   {duration(found.duration_s)}"
    yield f"  messages   {found.message_count}"
    if not found.indexed:
        yield "  index      missing: the file was scanned from its beginning"
    yield f"  writer     {printable(found.library)}, profile {printable(found.profile) or 'none'}"
    table = TopicLines((topic.name, topic.type_name) for topic in found.topics)
    if found.topics:
        yield ""
        yield table.header
    for topic in found.topics:
        yield table.row(topic.name, topic.type_name, topic.message_count, topic.rate_hz)
        qos = qos_text(topic.offered_qos)
        if qos:
            yield f"    {printable(qos)}"
    yield from event_lines(found.events)


def event_lines(events: Sequence[RecordedEvent]) -> Iterator[str]:
    """Yield a table of the last events, or nothing if there are none."""
    if events:
        yield ""
        earlier = len(events) - MAX_EVENTS_SHOWN
        yield "events" + (f" ({earlier} earlier ones: --json)" if earlier > 0 else "")
    for event in events[-MAX_EVENTS_SHOWN:]:
        yield f"  {moment(event.log_ns)}  {event.kind.value:<11}  {printable(event.text)}"


def qos_text(offered: str) -> str:
    """Return the QoS that a topic's publishers offered, in words; "" if the file has none.

    `offered` is YAML as rosbag2 writes it. No YAML parser is used, as the file may be hostile.
    """
    profiles = (
        dict(_ENTRY.findall(part)) for part in re.split(r"^- ", offered, flags=re.MULTILINE)
    )
    return "; ".join(dict.fromkeys(_profile_text(profile) for profile in profiles if profile))


def _profile_text(profile: dict[str, str]) -> str:
    words = []
    for policy, names in _POLICIES.items():
        value = profile.get(policy, "unknown")
        words.append(names.get(value, value))
    if words[-1] == "keep_last":
        words[-1] += f" {profile.get('depth', '')}"
    return ", ".join(word for word in words if word != "unknown")
