"""why: explain the last stop, refusal or fault."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from robotctl.base.errors import Refused, UnreadableFile
from robotctl.base.paths import DEFAULT_ROBOT
from robotctl.cli.options import Json, new_app
from robotctl.cli.targets.recordings import (
    LAST,
    RecordedBy,
    RecordingsFolder,
    committed_recording,
    find_recording,
    parse_moment,
    recording_path,
    robot_of,
    with_earlier,
)
from robotctl.cli.ui.output import Progress, print_answer, progress_bar
from robotctl.cli.ui.text import is_float, row, short_path
from robotctl.ipc.advice import advice, cure_of, for_robot
from robotctl.kernel.constants import NS_PER_S

if TYPE_CHECKING:
    from robotctl.check.incident import Incident

app = new_app()


@dataclass(frozen=True, slots=True)
class FoundIncident:
    """An incident (a stop or a refusal), with the recordings that were searched for it."""

    path: Path
    """The recording of the incident."""
    incident: Incident
    later: Sequence[Path]
    """Later recordings, which have no incident."""
    missing: Sequence[str]
    """A sentence for each unreadable part."""


@app.command()
def why(
    file: Annotated[
        str | None,
        typer.Argument(
            metavar="[FILE]",
            help="An MCAP file, a recording's folder or name, a folder of them, or `last` "
            "[default: the current recording, or the last one, or an earlier one].",
        ),
    ] = None,
    at: Annotated[
        str | None,
        typer.Option(
            metavar="T", help="Explain the stop nearest to T: seconds into it, 12:03:04, a date."
        ),
    ] = None,
    folder: RecordingsFolder = None,
    robot: RecordedBy = None,
    as_json: Json = False,
) -> None:
    """Say why the robot was stopped, or why a request was refused.

    Reads the journal of a recording; needs neither ROS nor a daemon. If a daemon is running, it
    first writes all pending messages to its recording. If nothing happened in the last recording,
    the earlier ones of the robot are searched.

    \b
    Examples:
      robotctl why
      robotctl why last --at 12:03:04
      robotctl why incident.mcap --json
      robotctl why s3://bucket/robots
    """
    missing: list[str] = []
    paths = _recordings_to_search(file, robot, folder, missing)
    with progress_bar("reading the journal", quiet=as_json) as on_progress:
        if at is None:
            found = _find(paths, None, missing, on_progress)
        else:
            path, at_ns = _at(paths, at, missing)
            found = _find([path], at_ns, missing, on_progress)
    print_answer(as_object(found), why_lines(found), as_json=as_json)


def _recordings_to_search(
    file: str | None, robot: str | None, folder: Path | None, missing: list[str]
) -> list[Path]:
    """Make a running daemon commit its recording; return the recordings to search, newest first.

    A sentence about messages that the daemon could not write is added to `missing`.
    """
    from robotctl.recording.read.files import is_bag

    if file not in (None, LAST) and (given := recording_path(file)).is_dir() and not is_bag(given):
        folder, file = (given, LAST) if any(map(is_bag, given.iterdir())) else (folder, file)
    newest = asked = None
    if file is None and folder is None:
        asked = robot or DEFAULT_ROBOT
        newest = committed_recording(asked, missing)
    if newest is None:
        newest = find_recording(file or LAST, robot, folder)
        recorded_by = robot_of(newest)
        if recorded_by not in (None, asked):
            committed_recording(recorded_by, missing)
    return with_earlier(newest) if file in (None, LAST) else [newest]


def _at(paths: Sequence[Path], at: str, missing: list[str]) -> tuple[Path, int]:
    """Return the recording to search for the time `at`, and that time [ns].

    The choice is the newest recording that contains the time, else the newest that begins before,
    else the newest. Seconds in `at` count from the start of the newest recording. Recordings that
    cannot be read are named in `missing`.

    Raises:
        UnreadableFile: No recording can be read.
    """
    from robotctl.recording import read_info

    unreadable: list[UnreadableFile] = []
    readable: list[tuple[Path, int]] = []
    before: list[tuple[Path, int]] = []
    for path in paths:
        try:
            info = read_info(path)
        except UnreadableFile as error:
            unreadable.append(error)
            missing.append(str(error))
            continue
        at_ns = parse_moment(at, info.start_ns, info.end_ns)
        if is_float(at) or info.start_ns <= at_ns <= info.end_ns:
            return path, at_ns
        readable.append((path, at_ns))
        if info.message_count and info.start_ns <= at_ns:
            before.append((path, at_ns))
    if not readable:
        raise unreadable[0]
    return (before or readable)[0]


def _find(
    paths: Sequence[Path], at_ns: int | None, missing: list[str], on_progress: Progress
) -> FoundIncident:
    """Return the last incident, or the one nearest to `at_ns`, of the first recording with one.

    A recording that cannot be read is named in `missing`.

    Raises:
        Refused: No recording has an incident.
        UnreadableFile: The only recording cannot be read.
    """
    from robotctl.check.incident import find_incident

    later: list[Path] = []
    for path in paths:
        try:
            searched = find_incident(path, at_ns, on_progress)
        except UnreadableFile as error:
            if len(paths) == 1:
                raise
            missing.append(str(error))
            continue
        missing += searched.missing
        if searched.incident is not None:
            return FoundIncident(path, searched.incident, later, missing)
        later.append(path)
    before = "" if len(paths) == 1 else f" and {len(paths) - 1} before it"
    but = f" (but {'; '.join(missing)})" if missing else ""
    raise Refused(f"{paths[0]}{before}: the robot was not stopped, and nothing was refused{but}")


def why_lines(found: FoundIncident) -> Iterator[str]:
    """Yield the lines of `robotctl why`."""
    from robotctl.check.why import explain

    incident, robot = found.incident, robot_of(found.path) or DEFAULT_ROBOT
    told = explain(incident)
    yield from row(f"{_clock(incident)}  ", advice(told.what, told.remedies, robot).sentence)
    rows = (
        ("came in", told.came_in),
        ("known", told.known),
        ("rule", told.rule),
        ("asked for", told.asked),
        *(("went out" if not i else "", text) for i, text in enumerate(told.went_out)),
        ("since", for_robot(told.since, robot)),
        ("then", _later(found)),
        *(("missing", sentence) for sentence in found.missing),
    )
    for label, text in rows:
        if text:
            yield from row(f"  {label:12}", text)
    after_s = (incident.t_ns - incident.begin_ns) / NS_PER_S
    yield f"  {'recorded in':12}{short_path(found.path)}, {after_s:.3f} s after its beginning"


def _later(found: FoundIncident) -> str:
    count = len(found.later)
    if not count:
        return ""
    what = "a later recording" if count == 1 else f"{count} later recordings"
    return f"{what} without a stop or a refusal, up to {short_path(found.later[0])}"


def as_object(found: FoundIncident) -> dict[str, Any]:
    """Return the object for `why --json`; `log_ns` is the incident's time since the epoch."""
    from robotctl.check.journal import text_of
    from robotctl.check.why import explain, rule_of

    incident, robot = found.incident, robot_of(found.path) or DEFAULT_ROBOT
    told = explain(incident)
    rule = rule_of(incident)
    sent_ms = None if incident.zero_ns is None else (incident.zero_ns - incident.log_ns) / 1e6
    return {
        "path": str(found.path),
        "later": [str(path) for path in found.later],
        "kind": incident.kind.value,
        "seq": incident.seq,
        "log_ns": incident.log_ns,
        "after_s": (incident.t_ns - incident.begin_ns) / NS_PER_S,
        "mode_before": incident.before.mode.name if incident.before else None,
        "mode": incident.after.mode.name if incident.after else None,
        "cause": rule.cause.value if rule else None,
        "cure": cure_of(rule.remedy, robot) if rule else None,
        "zero_after_ms": sent_ms,
        "event": text_of(incident.event),
        "effects": [text_of(effect) for effect in incident.effects],
        "what": advice(told.what, told.remedies, robot).sentence,
        "came_in": told.came_in,
        "known": told.known,
        "rule": told.rule,
        "asked": told.asked,
        "went_out": list(told.went_out),
        "since": for_robot(told.since, robot),
        "missing": list(found.missing),
    }


def _clock(incident: Incident) -> str:
    """Return the time of day of the incident, with milliseconds."""
    seconds, rest_ns = divmod(incident.log_ns, NS_PER_S)
    try:
        day = time.strftime("%H:%M:%S", time.localtime(seconds))
    except (OverflowError, ValueError, OSError):  # the file may contain any number
        return f"{incident.log_ns} ns"
    return f"{day}.{rest_ns // 10**6:03}"
