"""info, recordings: show what a recording contains; list, keep and remove recordings."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from robotctl.base.errors import IN_PARENTHESES, Interrupted, Refused, UnreadableFile, UsageError
from robotctl.base.paths import DEFAULT_ROBOT
from robotctl.cli.options import Json, RecordingFile, given_options, new_app, new_group
from robotctl.cli.targets.recordings import (
    RecordedBy,
    RecordingsFolder,
    cure_of_damage,
    find_recording,
    recordings_folder,
    robot_of,
)
from robotctl.cli.ui.output import print_answer, progress_bar
from robotctl.cli.ui.status import topic_table
from robotctl.cli.ui.text import (
    column_width,
    columns,
    duration,
    elided,
    moment,
    printable,
    row,
    short_path,
    size,
)
from robotctl.ipc.client import command_for
from robotctl.kernel.constants import NS_PER_S

if TYPE_CHECKING:
    from robotctl.recording import RecordingInfo
    from robotctl.recording.format.recorded_events import RecordedEvent
    from robotctl.recording.keep.listing import ListedRecording


app = new_app()

MAX_EVENTS_SHOWN = 20

_POLICIES = {
    "reliability": {"1": "reliable", "2": "best_effort"},
    "durability": {"1": "transient_local", "2": "volatile"},
    "history": {"1": "keep_last", "2": "keep_all", "3": "unknown"},
}
"""The names of QoS values by their numbers in rmw/types.h.

rosbag2 wrote the numbers before version 9 of its metadata.
"""

# No YAML parser, as the file may be hostile.
_ENTRY = re.compile(r"^ *(reliability|durability|history|depth): *(\w+)", re.MULTILINE)


@app.command()
def info(
    file: RecordingFile,
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
    why = f"{path} is incomplete: {'; '.join(found.missing)}"
    error = UnreadableFile(why, cure_of_damage(path)) if found.missing else None
    print_answer(as_object(found), info_lines(found), as_json=as_json, error=error)


def as_object(found: RecordingInfo) -> dict[str, Any]:
    """Return the object for `info --json`; times in `_ns` are since the epoch."""
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
    times = {"start": moment(found.start_ns), "duration": duration(found.duration_s)}
    no_index = {"index": "missing: the file was scanned from its beginning"}
    facts = {
        "size": f"{size(found.size_bytes)}{files}",
        **(times if found.message_count else {}),
        "messages": found.message_count,
        **({} if found.indexed else no_index),
        "writer": f"{printable(found.library)}, profile {printable(found.profile) or 'none'}",
    }
    yield short_path(found.path)
    yield from (f"  {name:10} {value}" for name, value in facts.items())
    header, *rows = topic_table(
        (topic.name, topic.type_name, topic.message_count, topic.rate_hz) for topic in found.topics
    )
    if found.topics:
        yield from ("", header)
    for topic, line in zip(found.topics, rows, strict=True):
        yield line
        if qos := qos_text(topic.offered_qos):
            yield f"    {printable(qos)}"
    yield from event_lines(found.events)


def event_lines(events: Sequence[RecordedEvent]) -> Iterator[str]:
    """Yield a table of the last MAX_EVENTS_SHOWN events, nothing without events."""
    if events:
        yield ""
        earlier = len(events) - MAX_EVENTS_SHOWN
        yield "events" + (f" ({earlier} earlier ones: --json)" if earlier > 0 else "")
    for event in events[-MAX_EVENTS_SHOWN:]:
        yield f"  {moment(event.log_ns)}  {event.kind.value:<11}  {printable(event.text)}"


def qos_text(offered: str) -> str:
    """Return the QoS that a topic's publishers offered, in words; "" if the file has none.

    `offered` is YAML as rosbag2 writes it.
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


def remove(path: Path, *, without_asking: bool) -> int:
    """Remove the recording in the folder `path`, and return its size [bytes].

    Raises:
        Refused: The folder is no recording of robotctl, is still being recorded, is marked with
            `recordings keep`, or cannot be read or removed.
        UsageError: The user must be asked, and there is no terminal.
        Interrupted: The user said no.
    """
    from robotctl.recording.keep.listing import own_recording
    from robotctl.recording.keep.retention import remove_recording

    try:
        recording = own_recording(path)
    except OSError as error:
        raise Refused(f"{path} cannot be read: {error.strerror}") from error
    if recording is None:
        raise Refused(
            f"{path} is not the folder of a recording of robotctl",
            "see: robotctl recordings",
            sentence=IN_PARENTHESES,
        )
    if recording.live:
        raise Refused(f"{path} is being recorded", "first: robotctl stop", sentence=IN_PARENTHESES)
    if recording.kept:
        raise Refused(
            f"{path} is kept",
            f"first: robotctl recordings unkeep {path.name}",
            sentence=IN_PARENTHESES,
        )
    total = sum(file.size for file in (*recording.files, *recording.clips))
    if not without_asking:
        _ask(f"remove {printable(str(path))} ({size(total)})?")
    try:
        return sum(each.size for each in remove_recording(recording))
    except OSError as error:
        raise Refused(f"{error.filename} cannot be removed: {error.strerror}") from error


def _ask(question: str) -> None:
    if not sys.stdin.isatty():
        raise UsageError("there is no terminal to ask on", "give --yes", sentence=IN_PARENTHESES)
    print(f"{question} [y/N] ", end="", file=sys.stderr, flush=True)
    if sys.stdin.readline().strip().lower() not in ("y", "yes"):
        raise Interrupted("nothing was removed")


group = new_group(app, "recordings")

Name = Annotated[
    str, typer.Argument(metavar="RECORDING", help="A recording's name or folder, or `last`.")
]

_NAME_WIDTH = 26
_OTHER_COLUMNS_WIDTH = 54


@group.callback(invoke_without_command=True)
def recordings(
    context: typer.Context,
    folder: RecordingsFolder = None,
    robot: RecordedBy = None,
    as_json: Json = False,
) -> None:
    """List recordings with duration, laps and the worst event.

    Lists ./recordings or, if that has none, the folder of the running or last daemon. A daemon
    that starts removes the oldest recordings (see recording.max_total_gb), except those marked
    with keep.

    \b
    Examples:
      robotctl recordings
      robotctl recordings --json | jq -r '.recordings[] | .path'
      robotctl recordings keep robot_20260101_120000
      robotctl recordings unkeep robot_20260101_120000
    """
    if context.invoked_subcommand is not None:
        for option in given_options(context).values():
            command = context.invoked_subcommand
            cure = f"give it after: robotctl recordings {command} NAME {option} ..."
            raise UsageError(f"{option} is given before {command}", cure)
        return
    from robotctl.recording.keep.listing import list_recordings

    place = recordings_folder(robot, folder)
    found: list[ListedRecording] = []
    if place.is_dir():
        try:
            with progress_bar("reading", quiet=as_json) as on_progress:
                found = [
                    each
                    for each in list_recordings(place, on_progress)
                    if robot in (None, each.robot, robot_of(each.path))
                ]
        except OSError as error:
            raise Refused(f"{place} cannot be listed: {error.strerror}") from error
    answer = {"folder": str(place), "recordings": [_as_object(each) for each in found]}
    print_answer(answer, _lines(place, found, robot or DEFAULT_ROBOT), as_json=as_json)


@group.command()
def keep(
    name: Name, folder: RecordingsFolder = None, robot: RecordedBy = None, as_json: Json = False
) -> None:
    """Keep this recording at any age.

    \b
    Examples:
      robotctl recordings keep last
    """
    _set_kept(name, folder, robot, "is kept at any age", kept=True, as_json=as_json)


@group.command()
def unkeep(
    name: Name, folder: RecordingsFolder = None, robot: RecordedBy = None, as_json: Json = False
) -> None:
    """Let this recording be removed again when it is old.

    \b
    Examples:
      robotctl recordings unkeep robot_20260101_120000
    """
    told = "may be removed again when it is old"
    _set_kept(name, folder, robot, told, kept=False, as_json=as_json)


@group.command()
def rm(
    name: Name,
    folder: RecordingsFolder = None,
    robot: RecordedBy = None,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Do not ask.")] = False,
    as_json: Json = False,
) -> None:
    """Remove a recording with its clips, after a question.

    A recording that is being written, or that is kept, is not removed. A seal cannot tell who
    removed it: `verify` of later recordings names it as missing.

    \b
    Examples:
      robotctl recordings rm robot_20260101_120000
      robotctl recordings rm last --yes
    """
    removed_bytes = remove(path := find_recording(name, robot, folder), without_asking=yes)
    told = f"{printable(path.name)} is removed: {size(removed_bytes)}"
    answer = {"path": str(path), "removed_bytes": removed_bytes}
    print_answer(answer, [told], as_json=as_json)


def _set_kept(
    name: str, folder: Path | None, robot: str | None, told: str, *, kept: bool, as_json: bool
) -> None:
    from robotctl.recording.keep.listing import set_kept

    path = find_recording(name, robot, folder)
    if not path.is_dir():
        raise Refused(
            f"{path} is not the folder of a recording",
            "see: robotctl recordings",
            sentence=IN_PARENTHESES,
        )
    try:
        set_kept(path, kept)
    except OSError as error:
        raise Refused(f"{path} cannot be changed: {error.strerror}") from error
    answer = {"path": str(path), "kept": kept}
    print_answer(answer, [f"{printable(path.name)} {told}"], as_json=as_json)


def _as_object(each: ListedRecording) -> dict[str, Any]:
    from robotctl.recording.format.recorded_events import ERRORS

    return {
        "name": each.path.name,
        "path": str(each.path),
        "robot": each.robot or None,
        "start_ns": each.start_ns,
        "duration_s": each.duration_s,
        "size_bytes": each.size_bytes,
        "files": each.files,
        "laps": each.laps,
        "driven_s": each.driven_s,
        **{error: each.largest(error) for error in ERRORS},
        "worst": None if each.worst is None else each.worst.value,
        "readable": each.readable,
        "damage": list(each.damage),
        "live": each.live,
        "kept": each.kept,
        "clips": [str(clip) for clip in each.clips],
    }


def _lines(place: Path, found: Sequence[ListedRecording], robot: str) -> Iterator[str]:
    if not found:
        start = command_for(robot, "start")
        yield f"no recordings in {short_path(place)} (start one: {start})"
        return
    yield f"{short_path(place)}: {size(sum(each.size_bytes for each in found))}"
    names = (each.path.name for each in found)
    most = max(columns() - _OTHER_COLUMNS_WIDTH, _NAME_WIDTH)
    width = column_width(names, at_least=_NAME_WIDTH, at_most=most)
    yield (f"  {'name':{width}} {'start':16} {'size':>8} {'duration':>11} {'laps':>4}  worst")
    for each in found:
        begun_ns = each.start_ns or round(each.modified_s * NS_PER_S)
        worst = "-" if each.worst is None else each.worst.value
        yield (
            f"  {elided(each.path.name, width):{width}} {moment(begun_ns)[:16]} "
            f"{size(each.size_bytes):>8} {duration(each.duration_s):>11} {each.laps:>4}  "
            f"{worst:5} {', '.join(_remarks(each))}"
        ).rstrip()
        if driven := ", ".join(_drive_figures(each)):
            yield from row("    drives: ", driven)
    if any(each.damage for each in found):
        yield "for damaged ones, robotctl recover NAME saves what can be read"


def _drive_figures(each: ListedRecording) -> Iterator[str]:
    """Yield the largest errors of all drives, true errors in brackets, and the time driven."""
    for name, what in (
        ("cross_track_max_m", "m off track"),
        ("heading_max_rad", "rad off heading"),
        ("closure_m", "m closure"),
    ):
        measured, true = each.largest(name), each.largest(f"true_{name}")
        if measured is not None:
            in_truth = "" if true is None else f" ({true:.3f} in truth)"
            yield f"{measured:.3f} {what}{in_truth}"
    if each.driven_s is not None:
        yield duration(each.driven_s)


def _remarks(each: ListedRecording) -> Iterator[str]:
    if each.live:
        yield "live"
    if each.kept:
        yield "kept"
    if each.clips:
        yield f"{len(each.clips)} clip{'s' * (len(each.clips) > 1)}"
    if not each.readable:
        yield "unreadable"
    elif each.damage:
        yield "damaged"
