"""Judges one recording, unless its result is stored: the work of one job, on any machine."""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from robotctl.errors import Refused, RobotctlError, UnreadableFile
from robotctl.fleet.jobs import Done, Processes, local_processes, local_threads, results_of
from robotctl.fleet.judgement import Judgement, crashed, judge, key_of
from robotctl.fleet.recording_content import BeingWritten, Content, read_content
from robotctl.fleet.result_store import ResultStore
from robotctl.fleet.software import software_hash, software_name


@dataclass(frozen=True, slots=True)
class Judged:
    """The answer of a job: a judgement, and whether the store had it; or what is in the way.

    A recording that is `live` is still being written, and left out.
    """

    judgement: Judgement | None
    was_stored: bool = False
    problem: str = ""
    live: bool = False


@dataclass(frozen=True, slots=True)
class Judging:
    """What the jobs of a gate have in common; it can be sent to another process or machine."""

    settings: dict[str, str]
    store: ResultStore
    software: str
    """The hash of the robotctl that asks: a result of another one is none."""

    def judged(self, path: Path) -> Judged:
        """Return the stored result, else judge the recording and store the result.

        A recording at which robotctl itself fails is judged, but not stored: the failure may come
        from what is installed here.

        Raises:
            Refused: The robotctl of this process is another one, or the result cannot be stored.
        """
        if software_hash() != self.software:
            raise Refused(
                f"{platform.node()} has another robotctl ({software_name()}) than the gate",
                "give both the same, and start the workers again",
            )
        try:
            content = read_content(path)
            if (known := self._get(content)) is not None:
                return known
            try:
                found = judge(path, self.settings, content)
            except (OSError, UnreadableFile, MemoryError):
                raise
            except RobotctlError as error:  # what is installed here cannot read it
                return Judged(None, problem=f"{platform.node()}: {error}")
            except Exception as error:  # noqa: BLE001 - a bug of the kernel may raise anything
                content.check(path)
                return Judged(crashed(content, self.settings, error))
        except (OSError, UnreadableFile, MemoryError) as error:
            return _unread(error)
        return Judged(self.store.put(found))

    def stored(self, path: Path) -> Judged | None:
        """Return the result if it is stored, or why the recording cannot be read.

        Raises:
            Refused: The store cannot be read.
        """
        try:
            return self._get(read_content(path))
        except (OSError, UnreadableFile) as error:
            return _unread(error)

    def _get(self, content: Content) -> Judged | None:
        known = self.store.get(key_of(content.digest, self.settings))
        return None if known is None else Judged(known, was_stored=True)


Answers = Iterator[tuple[Path, Judged | None]]
"""Each recording with its answer, in any order; None where the process was killed."""

Engine = Callable[[Judging, Sequence[Path], Done], Answers]
"""Does the jobs of a gate."""


def judge_here(
    judging: Judging,
    recordings: Sequence[Path],
    on_progress: Done,
    processes: Processes = local_processes,
) -> Answers:
    """Do the jobs on this machine; no process is started for what is stored."""
    new: list[Path] = []
    done = 0
    for path, known in results_of(judging.stored, recordings, local_threads):
        if known is None:
            new.append(path)
        else:
            done += 1
            on_progress(done, len(recordings))
            yield path, known

    def tell(more: int, _: int) -> None:
        on_progress(done + more, len(recordings))

    yield from results_of(judging.judged, new, processes, tell)


def _unread(error: OSError | UnreadableFile | MemoryError) -> Judged:
    if isinstance(error, BeingWritten):
        return Judged(None, problem=str(error), live=True)
    said = (error.strerror if isinstance(error, OSError) else "") or str(error) or "no memory"
    return Judged(None, problem=f"{platform.node()} cannot read it: {said}")
