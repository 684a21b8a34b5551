"""why: the chain that led to the last stop, refusal or fault."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from robotctl.cli.library import LAST, Recordings, find_recording
from robotctl.cli.moments import parse_moment
from robotctl.cli.options import Json, Robot, new_app
from robotctl.cli.progress import progress_bar
from robotctl.cli.text import json_text, row, short_path
from robotctl.paths import DEFAULT_ROBOT

if TYPE_CHECKING:
    from robotctl.replay.incident import Incident

app = new_app()


@app.command()
def why(
    file: Annotated[
        str,
        typer.Argument(metavar="[FILE]", help="An MCAP file, a recording's folder or name."),
    ] = LAST,
    at: Annotated[
        str | None,
        typer.Option(
            metavar="T", help="What is nearest to it: seconds into the recording, 12:03:04, a date."
        ),
    ] = None,
    folder: Recordings = None,
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Say why the robot was stopped last, or why a request was refused.

    From the journal of a recording, also of one that goes on; needs neither ROS nor a daemon.

    \b
    Examples:
      robotctl why
      robotctl why last --at 12:03:04
      robotctl why incident.mcap --json
    """
    from robotctl.recording.reader import read_info
    from robotctl.replay.incident import find_incident

    path = find_recording(file, robot, folder)
    at_ns = None if at is None else parse_moment(at, read_info(path).start_ns)
    with progress_bar("reading the journal", quiet=as_json) as on_progress:
        incident = find_incident(path, at_ns, on_progress)
    if as_json:
        print(json_text(as_object(path, incident)))
    else:
        print("\n".join(why_lines(path, incident)))


def why_lines(path: Path, incident: Incident) -> Iterator[str]:
    """The sentences, as operators read them."""
    from robotctl.replay.why import explain

    told = explain(incident)
    yield from row(f"{_clock(incident)}  ", told.what)
    rows = (
        ("came in", told.came_in),
        ("known", told.known),
        ("rule", told.rule),
        ("asked for", told.asked),
        *(("went out" if not i else "", text) for i, text in enumerate(told.went_out)),
        ("since", told.since),
        *(("missing", sentence) for sentence in incident.missing),
    )
    for label, text in rows:
        if text:
            yield from row(f"  {label:12}", text)
    after_s = (incident.t_ns - incident.begin_ns) / 1e9
    yield f"  {'recorded in':12}{short_path(path)}, {after_s:.3f} s after its beginning"


def as_object(path: Path, incident: Incident) -> dict[str, Any]:
    """The object of `why --json`; times in seconds, milliseconds and ns since the epoch."""
    from robotctl.replay.values import text_of
    from robotctl.replay.why import explain, rule_of

    told = explain(incident)
    rule = rule_of(incident)
    sent_ms = None if incident.zero_ns is None else (incident.zero_ns - incident.log_ns) / 1e6
    return {
        "path": str(path),
        "kind": incident.kind.value,
        "seq": incident.seq,
        "log_ns": incident.log_ns,
        "after_s": (incident.t_ns - incident.begin_ns) / 1e9,
        "mode_before": incident.before.mode.name if incident.before else None,
        "mode": incident.after.mode.name if incident.after else None,
        "cause": rule.cause.value if rule else None,
        "cure": rule.cure if rule else None,
        "zero_after_ms": sent_ms,
        "event": text_of(incident.event),
        "effects": [text_of(effect) for effect in incident.effects],
        "what": told.what,
        "came_in": told.came_in,
        "known": told.known,
        "rule": told.rule,
        "asked": told.asked,
        "went_out": list(told.went_out),
        "since": told.since,
        "missing": incident.missing,
    }


def _clock(incident: Incident) -> str:
    """The time of day, to the millisecond."""
    seconds, rest_ns = divmod(incident.log_ns, 10**9)
    try:
        day = time.strftime("%H:%M:%S", time.localtime(seconds))
    except (OverflowError, ValueError, OSError):  # a file may claim anything
        return f"{incident.log_ns} ns"
    return f"{day}.{rest_ns // 10**6:03}"
