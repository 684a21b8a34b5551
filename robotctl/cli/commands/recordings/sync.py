"""sync: copy finished recordings to a folder or a bucket, and on request remove them here."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Self

import typer

from robotctl.base.errors import (
    IN_PARENTHESES,
    Divergence,
    Interrupted,
    NoDaemon,
    Refused,
    RobotctlError,
    UnreadableFile,
    UsageError,
)
from robotctl.base.paths import DEFAULT_ROBOT
from robotctl.cli.options import Json, Robot, new_app
from robotctl.cli.targets.recordings import RecordingsFolder, recordings_folder
from robotctl.cli.ui.output import print_answer, progress_bar
from robotctl.cli.ui.text import row, short_path, size
from robotctl.ipc.client import NoAnswer, call
from robotctl.ipc.method_names import STATUS

if TYPE_CHECKING:
    from robotctl.collection.sources import OfferedRecording
    from robotctl.collection.sync import Pruned, Synced


app = new_app()

BURST_S: Final = 0.5
"""After a pause, the limit's bytes of this time [s] may be sent at once."""

_BITS: Final = 8e-6
"""Megabits per byte."""

_LOOK_EACH_S: Final = 1.0
_ANSWER_S: Final = 2.0


@app.command()
def sync(
    places: Annotated[
        list[str],
        typer.Argument(
            metavar="[FROM] TO",
            help="Folders, or s3://, gs://, az://BUCKET/PATH [FROM: the folder of recordings].",
        ),
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
    """Copy recordings to a folder or a bucket, or from there; a file is sent once.

    Each finished file, also of a damaged recording or of another tool, becomes RECORDING/FILE
    below TO. A file in TO with other content is reported and stays; only metadata.yaml and the
    index are replaced by newer ones. The next run continues one that was killed. FROM is a folder
    of recordings, one recording, or one file. Only with --max-age-days or --max-total-gb, files of
    robotctl are removed here, once read back from TO with the same bytes; a recording marked by
    `recordings keep` stays. URLs need the extra robotctl[store]. The exit code is 6 if something
    was left out, or could not be copied or read back, 7 if TO has other content.

    \b
    Examples:
      robotctl sync s3://bucket/robots/one
      robotctl sync /mnt/usb/one --dry-run
      robotctl sync s3://bucket/robots/one --limit-mbps 20 --pause-while-moving
      robotctl sync s3://bucket/robots/one --max-age-days 7
      robotctl sync s3://bucket/robots/one ./one
    """
    from robotctl.base.store import open_store
    from robotctl.base.store.objects import is_url
    from robotctl.collection.sources import is_one_recording
    from robotctl.collection.sync import Pruned, copy_recordings, prune
    from robotctl.kernel.constants import DAY_S, NS_PER_S
    from robotctl.recording.keep.retention import RetentionPolicy

    source, target = _ends(places, folder, robot)
    policy = RetentionPolicy(
        None if max_total_gb is None else round(max_total_gb * 1e9),
        None if max_age_days is None else max_age_days * DAY_S,
    )
    removes = policy != RetentionPolicy(None, None)
    if removes and (is_url(source) or is_one_recording(Path(source))):
        raise UsageError(f"nothing can be removed from {source}", "give a folder of recordings")
    store = open_store(target)
    pruned = Pruned()
    try:
        with SyncPace(limit_mbps, robot if pause_while_moving else None) as pace:
            offered = _offered(source)
            with progress_bar("copying", quiet=as_json) as on_progress:
                run = copy_recordings(
                    offered, store, pace=pace, on_progress=on_progress, dry_run=dry_run
                )
            if removes and not dry_run:
                with progress_bar("reading back", quiet=as_json):  # how much depends on retention
                    now_s = time.time_ns() / NS_PER_S
                    there = {*run.complete, *run.live}
                    pruned = prune(Path(source), store, policy, now_s, complete=there, pace=pace)
    except OSError as error:
        raise Refused(f"{source} cannot be listed: {error.strerror or error}") from error
    answer = _as_object(store.name, source, run, pruned, dry_run=dry_run)
    lines = _lines(store.name, source, run, pruned, dry_run=dry_run)
    print_answer(answer, lines, as_json=as_json, error=_error(run, pruned))


def _ends(places: list[str], folder: Path | None, robot: str) -> tuple[str, str]:
    """Return the source and the target of the copy: folders or URLs.

    Raises:
        UsageError: There are more than two places, or one cannot be used.
    """
    from robotctl.base.store.objects import is_url, parse_url

    if len(places) > 2:
        raise UsageError(f"{len(places)} places are too many", "give [FROM] TO")
    if len(places) == 2 and folder is not None:
        raise UsageError("--recordings is FROM", "give one of them")
    if not all(places):
        raise UsageError("a place is empty", "name a folder or a URL")
    source = places[0] if len(places) == 2 else str(recordings_folder(robot, folder))
    target = places[-1]
    if not is_url(source) and not Path(source).exists():
        raise UsageError(f"{source}: no such folder")
    if not is_url(source) and Path(source).is_file() and not source.endswith(".mcap"):
        raise UsageError(f"{source} is no .mcap file", "give one, or a folder of recordings")
    if not is_url(target):
        _check_folder(Path(target), source)
    elif parse_url(target).scheme in ("https", "http"):
        raise UsageError(f"{target} is a web server, which accepts no files", "name a bucket")
    return source, target


def _check_folder(target: Path, source: str) -> None:
    """Check that `target` is usable as a folder.

    Raises:
        UsageError: `target` is a file, is in `source`, or has no parent (disk not mounted?).
    """
    from robotctl.base.store.objects import is_url

    if not target.parent.is_dir() or (target.exists() and not target.is_dir()):
        raise UsageError(f"{target}: no such folder", "mount the disk, or create it")
    if not is_url(source) and target.resolve().is_relative_to(Path(source).resolve()):
        raise UsageError(f"{target} is in the folder of recordings", "give another folder")


def _offered(source: str) -> list[OfferedRecording]:
    from robotctl.base.store.objects import has_hash_folders, is_url
    from robotctl.collection.sources import local_recordings, stored_recordings

    if is_url(source) or has_hash_folders(Path(source)):
        return stored_recordings(source)
    return local_recordings(Path(source), time.time_ns())


def _as_object(
    place: str, source: str, run: Synced, pruned: Pruned, *, dry_run: bool
) -> dict[str, Any]:
    return {
        "store": place,
        "folder": source,
        "dry_run": dry_run,
        "complete": run.complete,
        "copied_bytes": run.copied_bytes,
        "copied": [
            {
                "recording": file.recording,
                "file": file.name,
                "size_bytes": file.size_bytes,
                "sha256": file.sha256,
            }
            for file in run.copied
        ],
        "live": run.live,
        "removed": [str(each.path) for each in pruned.removed],
        "removed_bytes": sum(each.size for each in pruned.removed),
        "problems": run.problems + pruned.problems,
        "wrong": run.wrong + pruned.wrong,
    }


def _lines(place: str, source: str, run: Synced, pruned: Pruned, *, dry_run: bool) -> Iterator[str]:
    copied = f"{len(run.copied)} files, {size(run.copied_bytes)}"
    if dry_run:
        yield f"{short_path(source)}: {copied} would be copied to {place}"
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


def _error(run: Synced, pruned: Pruned) -> RobotctlError | None:
    if wrong := len(run.wrong) + len(pruned.wrong):
        return Divergence(f"{wrong} files there have other content than those here")
    if problems := len(run.problems) + len(pruned.problems):
        cure = "what is here stays; run it again"
        return UnreadableFile(f"{problems} problems", cure, sentence=IN_PARENTHESES)
    return None


class SyncPace:
    """Limits the rate of `sync`, and pauses it while a robot moves, until the `with` block ends."""

    def __init__(self, limit_mbps: float | None, robot: str | None) -> None:
        """Allow `limit_mbps` [Mbit/s], None for no limit, and nothing while `robot` moves."""
        self._bytes_per_s = None if limit_mbps is None else limit_mbps / _BITS
        self._robot = robot
        self._ended = threading.Event()
        self._look_s = self._free_s = time.monotonic()
        """The next times to ask the daemon for its mode, and to send more bytes."""

    def __enter__(self) -> Self:
        """Ask the daemon for its mode once.

        Raises:
            RobotctlError: The daemon refused; nothing is raised if no daemon runs or answers.
        """
        if self._robot is not None:
            with suppress(NoDaemon):  # another error ends the command before anything is sent
                _is_moving(self._robot)
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()

    def __call__(self, count: int) -> None:
        """Wait until the robot does not move and the limit allows `count` more bytes.

        Raises:
            Interrupted: The block has ended.
        """
        if self._robot is not None and time.monotonic() >= self._look_s:
            while _may_be_moving(self._robot):
                self._wait(_LOOK_EACH_S)
            self._look_s = time.monotonic() + _LOOK_EACH_S
        if self._bytes_per_s is not None:
            now_s = time.monotonic()
            self._free_s = max(self._free_s, now_s - BURST_S) + count / self._bytes_per_s
            self._wait(max(0.0, self._free_s - now_s))

    def _wait(self, seconds: float) -> None:
        if self._ended.wait(seconds):
            raise Interrupted


def _may_be_moving(robot: str) -> bool:
    """Return whether the robot moves; True if its daemon runs, but gives no status."""
    try:
        return _is_moving(robot)
    except NoDaemon as error:
        return isinstance(error, NoAnswer)
    except RobotctlError:
        return True


def _is_moving(robot: str) -> bool:
    return call(robot, STATUS, deadline_s=_ANSWER_S)["mode"] == "MOVING"
