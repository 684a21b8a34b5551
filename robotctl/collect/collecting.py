"""Copies the recordings of a folder to a store, each file under its hash."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from robotctl.collect.hash_ledger import HashLedger
from robotctl.collect.local_files import Pace
from robotctl.collect.local_recordings import LocalRecording, local_recordings
from robotctl.collect.manifest import CollectedFile
from robotctl.collect.object_names import CollectedRecording, collected_recordings
from robotctl.collect.recording_copy import RecordingCopy
from robotctl.printable import printable
from robotctl.store import ObjectStore, StoreError

GIVE_UP_AFTER: Final = 3
"""After this number of failed copies in a row the store counts as unreachable, and the run ends."""


@dataclass(slots=True)
class Collected:
    """What a run did: objects that were copied, by recording, and sentences about the rest."""

    complete: list[str] = field(default_factory=list)
    """Recordings that the store has completely."""

    copied: dict[str, list[CollectedFile]] = field(default_factory=dict)
    live: list[str] = field(default_factory=list)
    """Recordings that are being made: the store has their finished files."""

    problems: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    """Objects that do not hold what their name says."""

    @property
    def copied_bytes(self) -> int:
        """Bytes of the files that were copied."""
        return sum(file.size_bytes for files in self.copied.values() for file in files)

    def add(self, recording: LocalRecording, copy: RecordingCopy, *, dry_run: bool) -> None:
        """Add what became of a recording."""
        name = printable(recording.name)
        self.problems += (f"{name}: {said}" for said in copy.problems)
        self.wrong += copy.wrong
        if copy.sent:
            self.copied[recording.name] = copy.sent
        if recording.live:
            self.live.append(recording.name)
        elif not (copy.problems or copy.wrong or (dry_run and copy.sent)):
            self.complete.append(recording.name)


def collect(
    recordings: Path,
    store: ObjectStore,
    ledger: HashLedger,
    *,
    pace: Pace = lambda count: None,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
    dry_run: bool = False,
) -> Collected:
    """Copy what the store lacks; `on_progress` gets bytes done and in total.

    What cannot be copied is told in `problems`, and the next file or recording is tried.

    Raises:
        OSError: The folder cannot be listed.
        StoreError: The store cannot be listed.
    """
    there = collected_recordings(store.list())
    found = local_recordings(recordings, ledger.now_ns())
    run = Collected()
    total, done, sent, failed = sum(each.size_bytes for each in found), 0, 0, 0

    def send(count: int) -> None:
        pace(count)
        nonlocal sent
        sent += count
        on_progress(min(done + sent, total), total)

    for each in found:
        on_progress(done, total)
        sent = 0
        copy = RecordingCopy(each, there.get(each.name, CollectedRecording()), store, ledger, send)
        try:
            copy.make(dry_run=dry_run)
            failed = 0
        except StoreError as error:
            copy.problems.append(str(error))
            failed += 1
        run.add(each, copy, dry_run=dry_run)
        if failed == GIVE_UP_AFTER:
            run.problems.append(f"{store.name} fails too often: the rest is left for later")
            break
        done += each.size_bytes
    else:
        ledger.forget_the_rest()
    on_progress(total, total)
    return run
