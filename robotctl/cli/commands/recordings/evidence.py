"""evidence: report changes, stops, and their proofs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from robotctl.base.errors import Divergence, Refused, RobotctlError, UnreadableFile
from robotctl.base.paths import DEFAULT_ROBOT, check_robot_name
from robotctl.cli.options import Json, Robot, new_app
from robotctl.cli.targets.recordings import noted_folders, parse_since
from robotctl.cli.ui.output import print_answer, progress_bar
from robotctl.cli.ui.text import moment, printable, row, short_path, size
from robotctl.ipc.client import command_for

if TYPE_CHECKING:
    from robotctl.decisions.evidence import Evidence
    from robotctl.decisions.journal import LogContent


app = new_app()

_LIVE, _MISSING = "live", "missing"


@app.command()
def evidence(
    since: Annotated[
        str | None,
        typer.Option("--since", metavar="TIME", help="Only later: 30d, 12h, or 2026-01-31."),
    ] = None,
    recordings: Annotated[
        Path | None,
        typer.Option(
            "--recordings", metavar="DIR", help="Look for the recordings here as well, by name."
        ),
    ] = None,
    check: Annotated[
        bool,
        typer.Option(
            help="Read every byte of the recordings, and decide them again; it may take long."
        ),
    ] = True,
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Show who changed what, the stops, and what proves them.

    The facts are from the journal of decisions, which robotctl keeps for five years. A recording
    that still exists is checked as by `verify` and by `replay --check`. The exit code is 0, 6 if
    a recording could not be checked completely, and 7 if the journal or a recording is not as it
    was written.

    \b
    Examples:
      robotctl evidence --since 30d
      robotctl evidence --since 2026-01-31 --json | jq '.stops'
      robotctl evidence --no-check
    """
    from robotctl.decisions.evidence import KILLED, RUNS, collect
    from robotctl.decisions.journal import log_folder, read_log
    from robotctl.recording.seal import wrong_openings

    folder = log_folder(check_robot_name(robot))
    since_ns = 0 if since is None else parse_since(since, time.time_ns())
    log = read_log(folder)
    if not log.files:
        start = command_for(robot, "start")
        raise Refused(f"robot {robot!r} has no journal of decisions in {folder}", f"begin: {start}")
    log.broken += wrong_openings(log.opened)
    told, found = collect(log.entries), collect(log.entries, since_ns)
    items = list(_recordings(robot, told, found, recordings, since_ns))
    log.broken += [
        f"{path.name} knows an entry that is not there: the journal was cut off, or it was "
        "rewritten"
        for path in (Path(item["path"]) for item in items)
        if _knows_more(path, log)
    ]
    together = _prove(items, quiet=as_json) if check else None
    if found.daemons and found.daemons[-1]["end_ns"] is None:
        last = {"path": found.daemons[-1]["recording"], "state": _LIVE}
        runs = any(item | last == item for item in items)
        found.daemons[-1]["ended"] = RUNS if runs else KILLED
    answer = _as_object(robot, since_ns, folder, log, found) | {
        "recordings": items,
        "verify": together,
    }
    error = _gravest(log, items, together)
    print_answer(answer, evidence_lines(answer), as_json=as_json, error=error)


def _recordings(
    robot: str, told: Evidence, found: Evidence, elsewhere: Path | None, since_ns: int
) -> Iterator[dict[str, Any]]:
    """Yield the recordings in the journal of decisions, then the robot's other recordings.

    `told` has the facts of the whole journal, `found` those since `since_ns`. A recording that
    ended before `since_ns` is left out, unless `found` names it. A recording that is missing at its
    path is searched in `elsewhere`.
    """
    wanted = set(found.recordings())
    removed = {Path(str(item.get("file"))).parent.name for item in told.removed}
    folders, names = set(noted_folders(robot)), set()
    for name in told.recordings():
        path = Path(name)
        folders.add(path.parent)
        if elsewhere is not None and not path.exists():
            path = elsewhere / path.name
        names.add(path.name)
        item = _looked_at(path)
        if item["state"] == _MISSING and path.name in removed:
            item["state"] = "removed"
        if name in wanted or item.get("end_ns", -1) >= since_ns:
            yield item
    for path in sorted(path for folder in folders for path in folder.glob(f"{robot}_*")):
        if path.is_dir() and path.name not in names:
            names.add(path.name)
            item = _looked_at(path)
            is_own = any(head is not None for head, _ in _heads(path, robot))
            if is_own and item.get("end_ns", -1) >= since_ns:
                yield item | {"named": False}


def _looked_at(path: Path) -> dict[str, Any]:
    """Return a recording's object in `--json`, without verdicts."""
    from robotctl.recording.keep.listing import list_recording

    item = {"path": str(path), "state": _MISSING, "named": True}
    item |= {"verify": None, "check": None, "wrong": [], "unproved": []}
    try:
        listed = list_recording(path)
    except OSError:
        return item
    times = {"start_ns": listed.start_ns, "end_ns": listed.end_ns}
    state = _LIVE if listed.live else "kept" if listed.kept else "there"
    return item | times | {"state": state, "size_bytes": listed.size_bytes}


def _heads(recording: Path, robot: str = "") -> Iterator[tuple[str | None, int]]:
    """Yield the digest of the journal of decisions in each file, and the file's begin [ns].

    Files of an early version have None. If `robot` is given, files of other robots are skipped.
    """
    from robotctl.recording import read_info
    from robotctl.recording.format.names import INFO_RECORD
    from robotctl.recording.read.files import recording_files

    with suppress(UnreadableFile):  # the verdict on the recording says why
        for file in recording_files(recording):
            info = read_info(file)
            noted = info.metadata.get(INFO_RECORD, {})
            if robot in ("", noted.get("robot")):
                yield noted.get("decisions"), info.start_ns


def _knows_more(recording: Path, log: LogContent) -> bool:
    """Return whether a file of `recording` has a digest that the journal of decisions lacks."""
    first_ns = log.entries[0].time_ns if log.begins_later and log.entries else -1
    return any(
        head and head not in log.heads and start_ns > first_ns
        for head, start_ns in _heads(recording)
    )


def _prove(items: Sequence[dict[str, Any]], *, quiet: bool) -> dict[str, Any] | None:
    """Add verdicts to the finished `items`; return the summary of `verify`, or None."""
    from robotctl.check.run import check_recordings
    from robotctl.cli.commands.recordings.verify import verify_together

    finished = [item for item in items if "size_bytes" in item and item["state"] != _LIVE]
    if not finished:
        return None
    paths = [Path(item["path"]) for item in finished]
    verified = verify_together(paths, quiet=quiet)
    with progress_bar("checking", quiet=quiet) as on_progress:
        reports = check_recordings(paths, on_progress)
    for item, verify, report in zip(finished, verified.pop("recordings"), reports, strict=True):
        item |= {"verify": verify["verdict"], "check": report["verdict"]}
        item |= {name: verify[name] for name in ("wrong", "unproved")}
    return verified


def _as_object(
    robot: str, since_ns: int, folder: Path, log: LogContent, found: Evidence
) -> dict[str, Any]:
    times = [entry.time_ns for entry in log.entries]
    return {
        "robot": robot,
        "since_ns": since_ns or None,
        "journal": {
            "folder": str(folder),
            "files": len(log.files),
            "entries": len(log.entries),
            "first_ns": times[0] if times else None,
            "last_ns": times[-1] if times else None,
            "broken": log.broken,
            "notes": log.notes,
        },
        **asdict(found),
    }


def _gravest(
    log: LogContent, items: Sequence[dict[str, Any]], together: dict[str, Any] | None
) -> RobotctlError | None:
    def those(*verdicts: str) -> list[str]:
        return [each["path"] for each in items if {each["verify"], each["check"]} & {*verdicts}]

    if log.broken:
        return Divergence(f"the journal of decisions is not as it was written: {log.broken[0]}")
    if wrong := those("broken", "diverged"):
        return Divergence(f"{len(wrong)} recordings are not as they were written: {wrong[0]}")
    if together is not None and together["wrong"]:
        return Divergence(f"the chain of the recordings is broken: {together['wrong'][0]}")
    if partly := those("unreadable", "incomplete"):
        return UnreadableFile(f"{len(partly)} recordings could not be checked: {partly[0]}")
    if unproved := [sentence for each in items for sentence in each["unproved"]]:
        return UnreadableFile(f"{len(unproved)} files have lost their seal: {unproved[0]}")
    return None


MOST_SHOWN: Final = 50
"""The maximum number of printed items of a list: the last items, or the first flaws."""

_INDENT = "  "


def evidence_lines(answer: Mapping[str, Any]) -> Iterator[str]:
    """Yield the lines of `robotctl evidence`; `answer` is its object in `--json`."""
    journal = answer["journal"]
    since = "" if answer["since_ns"] is None else f" since {moment(answer['since_ns'])}"
    yield f"robot {answer['robot']}{since}"
    yield from _field("journal", f"{journal['entries']} entries in {short_path(journal['folder'])}")
    if journal["first_ns"] is not None:
        yield from _field("from", moment(journal["first_ns"]))
        yield from _field("to", moment(journal["last_ns"]))
    yield from _field("appended to", "NO" if journal["broken"] else "and never changed")
    for sentences in (journal["broken"], journal["notes"]):
        for sentence in sentences[:MOST_SHOWN]:
            yield from _field("", sentence)
        if len(sentences) > MOST_SHOWN:
            yield from _field("", f"and {len(sentences) - MOST_SHOWN} more: --json")
    if answer["software"]:
        yield from ("", "software of the last start")
    for name, value in answer["software"].items():
        yield from _field(name, value)
    for title, name, text in (
        ("changes of software", "software_changes", _changed),
        ("changes of settings", "configuration_changes", _changed),
        ("daemons", "daemons", _daemon),
        ("stops", "stops", _mode),
        ("releases", "releases", _mode),
        ("interventions", "interventions", _request),
        ("refused", "refusals", _request),
        ("not written one by one", "unwritten", _unwritten),
        ("recordings that retention removed", "removed", lambda item: str(item.get("file", ""))),
    ):
        yield from _section(title, answer[name], text)
    yield from _recording_lines(answer["recordings"])
    for name, label in (("wrong", "wrong"), ("notes", "note")):
        for sentence in (answer["verify"] or {}).get(name, ()):
            yield from row(_INDENT, f"{label}: {sentence}")


def _section(
    title: str, items: Sequence[Mapping[str, Any]], text: Callable[[Mapping[str, Any]], str]
) -> Iterator[str]:
    yield ""
    if not items:
        yield f"{title}: none"
        return
    earlier = len(items) - MOST_SHOWN
    yield f"{title}: {len(items)}" + (f" ({earlier} earlier ones: --json)" if earlier > 0 else "")
    for item in items[-MOST_SHOWN:]:
        yield from row(f"{_INDENT}{moment(item['time_ns'])}  ", text(item))


def _changed(item: Mapping[str, Any]) -> str:
    by = f", by {item['by']}" if item.get("by") else ""
    if item["first"]:
        return f"noted for the first time{by}"
    changes = (f"{key}: {old} -> {new}" for key, (old, new) in item["changed"].items())
    return f"{'; '.join(changes)}{by}"


def _daemon(item: Mapping[str, Any]) -> str:
    until = "" if item["end_ns"] is None else f" until {moment(item['end_ns'])}"
    kind = "observer" if item.get("observe") else "driver"
    version = item.get("version", "")
    return f"{kind} {version} by {item.get('by', 'an unknown user')}{until}: {item['ended']}"


def _mode(item: Mapping[str, Any]) -> str:
    latch = " (latched)" if item.get("latched") else ""
    return f"{item.get('from')} -> {item.get('to')}{latch}: {item.get('reason', '')}"


def _request(item: Mapping[str, Any]) -> str:
    return f"{item.get('asked')} by {item.get('by')}: {item.get('answer')}"


def _unwritten(item: Mapping[str, Any]) -> str:
    counts = ", ".join(f"{count} {kind}" for kind, count in item.get("counts", {}).items())
    return f"{counts}, since {moment(item.get('first_ns', 0))}: the recordings hold them"


def _recording_lines(recordings: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    yield ""
    yield "recordings" if recordings else "recordings: none"
    for item in recordings:
        verdicts = [f"{name} {item[name]}" for name in ("verify", "check") if item[name]]
        told = ", ".join([item["state"], *verdicts])
        if "size_bytes" in item:
            told = f"{size(item['size_bytes'])}, {told}"
        yield from row(_INDENT, f"{short_path(item['path'])}: {told}")
        for label in ("wrong", "unproved"):
            for sentence in item[label]:
                yield from row(_INDENT * 2, f"{label}: {sentence}")


def _field(name: str, value: object) -> Iterator[str]:
    yield from row(f"{_INDENT}{printable(name):18} ", value)
