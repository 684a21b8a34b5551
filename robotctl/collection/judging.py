"""The job of the gate for one recording, which judges it unless the result is stored."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from uuid import uuid4

from robotctl.base.errors import Refused, RobotctlError, UnreadableFile
from robotctl.base.files import open_regular
from robotctl.base.pool import Done, Processes, local_processes, local_threads, results_of
from robotctl.collection.judgement import (
    BeingWritten,
    Content,
    Judgement,
    Typed,
    crashed,
    judge,
    key_of,
    read_content,
    software_hash,
    software_name,
)
from robotctl.recording.format.disk import replaced_file

MAX_BYTES: Final = 64 << 20


@dataclass(frozen=True, slots=True)
class _Sealed:
    """A stored result, with the SHA-256 of its JSON."""

    sha256: str
    result: dict[str, Any]


_sealed_result, _judgement = Typed(_Sealed), Typed(Judgement)


class ResultStore:
    """Stores judgements in a folder, which several gates may use at once."""

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder).absolute()

    def __str__(self) -> str:
        """Return the folder."""
        return str(self.folder)

    def get(self, key: str) -> Judgement | None:
        """Return the result stored for `key`, or None if it is missing or damaged.

        Raises:
            Refused: The result cannot be read.
        """
        try:
            with open_regular(self.folder / _name(key)) as file:
                data = file.read(MAX_BYTES + 1)
            if len(data) > MAX_BYTES:
                return None
            result = _opened(data)
        except (FileNotFoundError, ValueError):
            return None
        except OSError as error:
            raise self._refusal("read", error) from error
        return result if result.key == key else None

    def put(self, result: Judgement) -> Judgement:
        """Store a result unless its key is stored already; return the stored result.

        Raises:
            Refused: The store cannot be read or written.
        """
        if (stored := self.get(result.key)) is not None:
            return stored
        self._write(_name(result.key), _sealed(result))
        return result

    def put_token(self) -> str:
        """Create a file by which a worker recognizes this folder, and return its name.

        Raises:
            Refused: The store cannot be written.
        """
        name = f"{uuid4().hex}.token"
        self._write(name, name.encode())
        return name

    def _write(self, name: str, data: bytes) -> None:
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with replaced_file(self.folder / name) as file:
                file.write(data)
        except OSError as error:
            raise self._refusal("write", error) from error

    def has_token(self, name: str) -> bool:
        """Return whether the file that `put_token` created is in this folder."""
        return (self.folder / name).is_file()

    def remove_token(self, name: str) -> None:
        """Remove the file that `put_token` created, if it exists.

        Raises:
            Refused: The folder cannot be written.
        """
        try:
            (self.folder / name).unlink(missing_ok=True)
        except OSError as error:
            raise self._refusal("write", error) from error

    def _refusal(self, verb: str, error: OSError) -> Refused:
        return Refused(f"cannot {verb} results in {self.folder}: {error.strerror or error}")


def _sealed(result: Judgement) -> bytes:
    sealed = result.as_object()
    return json.dumps({"sha256": _hash(sealed), "result": sealed}).encode()


def _opened(data: bytes) -> Judgement:
    """Return the result in the bytes of a stored file, or raise ValueError if damaged."""
    try:
        found = _sealed_result(json.loads(data))
        if _hash(found.result) != found.sha256:
            raise ValueError("it was changed")
        return _judgement(found.result)
    except RecursionError as error:
        raise ValueError(str(error)) from error


def _hash(result: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(result, sort_keys=True).encode()).hexdigest()


def _name(key: str) -> str:
    return f"{key}.json"


@dataclass(frozen=True, slots=True)
class Judged:
    """The result of one job: a judgement, a `problem`, or `live` for a recording being written."""

    judgement: Judgement | None
    was_stored: bool = False
    problem: str = ""
    live: bool = False


@dataclass(frozen=True, slots=True)
class Judging:
    """What all jobs of a gate share. A job judges one recording, in any process or machine."""

    settings: dict[str, str]
    store: ResultStore
    software: str
    """The hash of the gate's robotctl, which each process must have."""

    def judged(self, path: Path) -> Judged:
        """Return the stored result, or judge the recording and store the result.

        A result with the verdict `crashed` is not stored.

        Raises:
            Refused: The software here is not the gate's, or the store cannot be read or written.
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
                content.check(path)  # not stored: what is installed here may be the cause
                return Judged(crashed(content, self.settings, error))
        except (OSError, UnreadableFile, MemoryError) as error:
            return _unread(error)
        return Judged(self.store.put(found))

    def stored(self, path: Path) -> Judged | None:
        """Return the stored result or None; for an unreadable recording, return the problem.

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
"""Each recording with its answer, None if the process was killed, in any order."""

Engine = Callable[[Judging, Sequence[Path], Done], Answers]
"""Runs the jobs of a gate."""


def judge_here(
    judging: Judging,
    recordings: Sequence[Path],
    on_progress: Done,
    processes: Processes = local_processes,
) -> Answers:
    """Yield each recording with its stored result, or a new one from a process on this machine."""
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
