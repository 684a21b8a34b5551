"""sync: copy finished recordings to a store, and remove them here once they are there."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from robotctl.cli.options import Json, Robot, new_app
from robotctl.cli.support.answer import print_answer
from robotctl.cli.support.recording_paths import RecordingsFolder, recordings_folder
from robotctl.cli.support.sync_pace import SyncPace
from robotctl.cli.terminal.progress import progress_bar
from robotctl.cli.terminal.text import row, short_path, size
from robotctl.errors import (
    IN_PARENTHESES,
    Divergence,
    Refused,
    RobotctlError,
    UnreadableFile,
    UsageError,
)
from robotctl.paths import DEFAULT_ROBOT

if TYPE_CHECKING:
    from robotctl.collect.collecting import Collected
    from robotctl.collect.pruning import Pruned

app = new_app()


@app.command()
def sync(
    place: Annotated[
        str, typer.Argument(metavar="URL", help="s3://, gs://, az://BUCKET/PATH, or a folder.")
    ],
    folder: RecordingsFolder = None,
    robot: Robot = DEFAULT_ROBOT,
    max_age_days: Annotated[
        float | None,
        typer.Option(min=0, metavar="DAYS", help="Then remove files here that are older."),
    ] = None,
    max_total_gb: Annotated[
        float | None,
        typer.Option(min=0, metavar="GB", help="Then remove the oldest files here beyond this."),
    ] = None,
    limit_mbps: Annotated[
        float | None,
        typer.Option(min=0.01, metavar="MBPS", help="At most this many megabits per second."),
    ] = None,
    pause_while_moving: Annotated[
        bool, typer.Option("--pause-while-moving", help="Wait while the robot is MOVING.")
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Say what would be copied; copy and remove nothing.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Copy all recordings of a folder to a store; a file is sent once.

    Each finished file, also of a damaged recording or of another tool, becomes
    RECORDING/SHA256/FILE below the URL and is never overwritten. A run that was killed goes on.
    Nothing is removed here without --max-age-days or --max-total-gb; then only files of robotctl
    that were read back from the store and hold the same bytes, and no recording with `recordings
    keep`. URLs need the extra robotctl[store], a folder needs nothing. The exit code is 6 if
    something was left out, or could not be copied or read back, 7 if the store holds other bytes
    than were stored.

    \b
    Examples:
      robotctl sync s3://bucket/robots/one
      robotctl sync /mnt/usb/one --dry-run
      robotctl sync s3://bucket/robots/one --limit-mbps 20 --pause-while-moving
      robotctl sync s3://bucket/robots/one --max-age-days 7
    """
    from robotctl.collect.collecting import collect
    from robotctl.collect.hash_ledger import hash_ledger
    from robotctl.collect.pruning import Pruned, prune
    from robotctl.kernel.units import DAY_S, NS_PER_S
    from robotctl.recording.keep.retention import RetentionPolicy
    from robotctl.store import is_url, open_store

    here = recordings_folder(robot, folder)
    if not place:
        raise UsageError("the URL is empty", "name a store or a folder")
    if not is_url(place):
        _check_folder(Path(place), here)
    store = open_store(place)
    policy = RetentionPolicy(
        None if max_total_gb is None else round(max_total_gb * 1e9),
        None if max_age_days is None else max_age_days * DAY_S,
    )
    pruned = Pruned()
    try:
        with (
            SyncPace(limit_mbps, robot if pause_while_moving else None) as pace,
            hash_ledger(here, time.time_ns) as ledger,
        ):
            with progress_bar("copying", quiet=as_json) as on_progress:
                run = collect(
                    here, store, ledger, pace=pace, on_progress=on_progress, dry_run=dry_run
                )
            if policy != RetentionPolicy(None, None) and not dry_run:
                with progress_bar("reading back", quiet=as_json):  # how much, retention decides
                    pruned = prune(here, store, policy, time.time_ns() / NS_PER_S, pace=pace)
    except OSError as error:
        raise Refused(f"{here} cannot be listed: {error.strerror or error}") from error
    answer = _as_object(store.name, here, run, pruned, dry_run=dry_run)
    lines = _lines(store.name, here, run, pruned, dry_run=dry_run)
    print_answer(answer, lines, as_json=as_json, error=_error(run, pruned))


def _check_folder(target: Path, recordings: Path) -> None:
    """Raise UsageError for a folder that is not there, as an unmounted disk, or the wrong one."""
    if not target.parent.is_dir() or (target.exists() and not target.is_dir()):
        raise UsageError(f"{target}: no such folder", "mount the disk, or create it")
    if target.resolve().is_relative_to(recordings.resolve()):
        raise UsageError(f"{target} is in the folder of recordings", "give another folder")


def _as_object(
    place: str, here: Path, run: Collected, pruned: Pruned, *, dry_run: bool
) -> dict[str, Any]:
    return {
        "store": place,
        "folder": str(here),
        "dry_run": dry_run,
        "complete": run.complete,
        "copied_bytes": run.copied_bytes,
        "copied": [
            {
                "recording": recording,
                "file": file.name,
                "size_bytes": file.size_bytes,
                "sha256": file.sha256,
            }
            for recording, files in run.copied.items()
            for file in files
        ],
        "live": run.live,
        "removed": [str(each.path) for each in pruned.removed],
        "removed_bytes": sum(each.size for each in pruned.removed),
        "problems": run.problems + pruned.problems,
        "wrong": run.wrong + pruned.wrong,
    }


def _lines(
    place: str, here: Path, run: Collected, pruned: Pruned, *, dry_run: bool
) -> Iterator[str]:
    copied = f"{sum(map(len, run.copied.values()))} files, {size(run.copied_bytes)}"
    if dry_run:
        yield f"{short_path(here)}: {copied} would be copied to {place}"
    else:
        lacks = run.problems or run.wrong
        nothing = "nothing was copied now" if lacks else "nothing was missing"
        now = f"{copied} copied now" if run.copied else nothing
        yield f"{place}: {len(run.complete)} recordings are there; {now}"
    for name in run.live:
        yield f"  {name} is being recorded: the file that is written follows later"
    if pruned.removed:
        removed_bytes = sum(each.size for each in pruned.removed)
        yield f"  {len(pruned.removed)} files are removed here: {size(removed_bytes)}"
    for said in (*run.problems, *run.wrong, *pruned.problems, *pruned.wrong):
        yield from row("  ", said)


def _error(run: Collected, pruned: Pruned) -> RobotctlError | None:
    if wrong := len(run.wrong) + len(pruned.wrong):
        return Divergence(f"{wrong} objects in the store are not what was stored")
    if problems := len(run.problems) + len(pruned.problems):
        cure = "what is here stays; run it again"
        return UnreadableFile(f"{problems} problems", cure, sentence=IN_PARENTHESES)
    return None
