"""evidence: one report of who changed what, which stops there were, and what proves it."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from robotctl.cli.options import Json, Robot, new_app
from robotctl.cli.support.answer import print_answer
from robotctl.cli.support.recording_paths import noted_folders
from robotctl.cli.support.time_argument import parse_since
from robotctl.cli.terminal.evidence_lines import evidence_lines
from robotctl.cli.terminal.progress import progress_bar
from robotctl.errors import Divergence, Refused, RobotctlError, UnreadableFile
from robotctl.ipc.client import command_for
from robotctl.paths import DEFAULT_ROBOT, check_robot_name

if TYPE_CHECKING:
    from robotctl.decisions.evidence import Evidence
    from robotctl.decisions.journal import LogContent
    from robotctl.evidence.recordings import EvidenceRecording

app = new_app()


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

    The journal of decisions tells it; robotctl keeps it for five years. A recording that is
    there is checked as by `verify`, together with the others, and `replay --check`. The exit code
    is 0, 6 if a recording could not be checked completely, and 7 if the journal or a recording is
    not as it was written.

    \b
    Examples:
      robotctl evidence --since 30d
      robotctl evidence --since 2026-01-31 --json | jq '.stops'
      robotctl evidence --no-check
    """
    from robotctl.decisions.evidence import KILLED, RUNS, collect
    from robotctl.decisions.journal import log_folder, read_log
    from robotctl.evidence.missing_entries import missing_entries
    from robotctl.evidence.recordings import RecordingSearch, RecordingState
    from robotctl.recording.read.known_heads import KnownHeads

    folder = log_folder(check_robot_name(robot))
    since_ns = 0 if since is None else parse_since(since, time.time_ns())
    log = read_log(folder)
    if not log.files:
        start = command_for(robot, "start")
        raise Refused(f"robot {robot!r} has no journal of decisions in {folder}", f"begin: {start}")
    told, found = collect(log.entries), collect(log.entries, since_ns)
    search = RecordingSearch(
        robot, list(noted_folders(robot)), recordings, since_ns, KnownHeads().of_robot(robot)
    )
    there = list(search.find(told, found))
    missing = missing_entries(log, [file for each in there for file in each.files], time.time_ns())
    log.broken += missing.broken
    log.notes += _unnamed(there, told)
    proof, together = _proof(there, check=check, quiet=as_json)
    if found.daemons and found.daemons[-1]["end_ns"] is None:
        runs = any(
            item["path"] == found.daemons[-1]["recording"] and item["state"] == RecordingState.LIVE
            for item in proof
        )
        found.daemons[-1]["ended"] = RUNS if runs else KILLED
    answer = _as_object(robot, since_ns, folder, log, missing.gaps, found) | {
        "recordings": proof,
        "verify": together,
    }
    error = _gravest(log, missing.gaps, proof, together)
    print_answer(answer, evidence_lines(answer), as_json=as_json, error=error)


def _proof(
    there: Sequence[EvidenceRecording], *, check: bool, quiet: bool
) -> tuple[list[dict[str, Any]], dict[str, Any] | None]:
    """Return each recording with what it is, and its verdicts if it is to be checked.

    The second object is what `verify` says of all that were checked together, None without a check.
    """
    from robotctl.cli.commands.verify.report import verify_together
    from robotctl.evidence.recordings import RecordingState
    from robotctl.rerun.check_many import check_recordings

    proof: list[dict[str, Any]] = []
    finished: list[tuple[Path, dict[str, Any]]] = []
    for each in there:
        item: dict[str, Any] = {
            "path": str(each.path),
            "state": each.state.value,
            "named": each.named,
            "verify": None,
            "check": None,
            "wrong": [],
            "unproved": [],
        }
        proof.append(item)
        if each.listed is None:
            continue
        item |= {
            "start_ns": each.listed.start_ns,
            "end_ns": each.listed.end_ns,
            "size_bytes": each.listed.size_bytes,
        }
        if check and each.state is not RecordingState.LIVE:
            finished.append((each.path, item))
    if not finished:
        return proof, None
    paths = [path for path, _ in finished]
    found_by_verify = verify_together(paths, quiet=quiet)
    with progress_bar("checking", quiet=quiet) as on_progress:
        reports = check_recordings(paths, on_progress)
    verdicts = zip(found_by_verify.recordings, reports, strict=True)
    for (path, item), (verify, report) in zip(finished, verdicts, strict=True):
        foreign = list(_of_other_recordings(path, verify))
        item |= {
            "verify": "broken" if foreign else verify["verdict"],
            "check": report["verdict"],
            "wrong": foreign + verify["wrong"],
            "unproved": verify["unproved"],
        }
    return proof, found_by_verify.summary


def _of_other_recordings(recording: Path, verify: dict[str, Any]) -> Iterator[str]:
    """Yield a sentence for each file in the place of a recording that was sealed for another."""
    for file in verify["files"]:
        sealed = file["seal"]["file"]
        if sealed and sealed.rpartition("_")[0] != recording.name:
            yield (
                f"{file['name']} was sealed as {sealed}: it is not of {recording.name}, which the "
                "journal names"
            )


def _unnamed(there: Sequence[EvidenceRecording], told: Evidence) -> Iterator[str]:
    """Yield a sentence for each recording that no entry names."""
    if any(item.get("counts", {}).get("start") for item in told.unwritten):
        return
    for each in there:
        if not each.named:
            yield (
                f"no entry names {each.path.name}: its daemon was killed at its start, or entries "
                "were cut off"
            )


def _as_object(
    robot: str,
    since_ns: int,
    folder: Path,
    log: LogContent,
    gaps: Sequence[str],
    found: Evidence,
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
            "gaps": list(gaps),
            "notes": log.notes,
        },
        "software": dict(found.software),
        "software_changes": found.software_changes,
        "configuration": dict(found.configuration),
        "configuration_changes": found.configuration_changes,
        "daemons": found.daemons,
        "interventions": found.interventions,
        "stops": found.stops,
        "releases": found.releases,
        "refusals": found.refusals,
        "removed": found.removed,
        "unwritten": found.unwritten,
    }


def _gravest(
    log: LogContent,
    gaps: Sequence[str],
    proof: Sequence[dict[str, Any]],
    together: dict[str, Any] | None,
) -> RobotctlError | None:
    wrong = list(_wrong(proof, ("broken",), ("diverged", "broken")))
    if log.broken:
        return Divergence(f"the journal of decisions is not as it was written: {log.broken[0]}")
    if wrong:
        return Divergence(f"{len(wrong)} recordings are not as they were written: {wrong[0]}")
    if together is not None and together["wrong"]:
        return Divergence(f"the chain of the recordings is broken: {together['wrong'][0]}")
    if gaps:
        return UnreadableFile(f"the journal of decisions is not complete: {gaps[0]}")
    partly = list(_wrong(proof, ("unreadable",), ("incomplete",)))
    if partly:
        return UnreadableFile(f"{len(partly)} recordings could not be checked: {partly[0]}")
    unproved = [sentence for item in proof for sentence in item["unproved"]]
    if unproved:
        return UnreadableFile(f"{len(unproved)} files have lost their seal: {unproved[0]}")
    return None


def _wrong(
    proof: Sequence[dict[str, Any]], verify: Sequence[str], check: Sequence[str]
) -> Iterator[str]:
    for item in proof:
        if item["verify"] in verify or item["check"] in check:
            yield item["path"]
