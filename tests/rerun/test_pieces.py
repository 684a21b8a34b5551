"""The report of a check does not depend on how the recording was cut, or who re-ran its pieces."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from itertools import cycle, islice
from pathlib import Path
from random import Random
from typing import Any

import psutil
import pytest

from robotctl import __version__
from robotctl.kernel.geometry import Pose
from robotctl.kernel.types import Event, Odometry, OdomReceived, Twist
from robotctl.kernel.units import NS_PER_S
from robotctl.recording import Recording
from robotctl.recording.format.journal import is_snapshot
from robotctl.recording.read.journal_reader import journal_topic
from robotctl.recording.read.topic_places import Spot
from robotctl.rerun import check as check_module
from robotctl.rerun import piece_pool
from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Verdict
from robotctl.rerun.piece import Position, confirmed_pieces
from robotctl.rerun.piece_pool import PiecePool, cut_places
from robotctl.rerun.rerun import ConfirmedPiece
from robotctl.testing.drives import BEGIN_NS, drive_requested
from tests.support.edited_recordings import Contents, write_contents
from tests.support.heard_drives import heard_drive
from tests.support.waiting import DEADLINE_S, until
from tests.tampering.kinds import FOUND, ONLY_IF_CLOSED

EDITS = 60


class Pieces:
    """What a pool would confirm, re-run in this process; some pieces are left to the check."""

    def __init__(self, recording: Recording, version: str, random: Random) -> None:
        topic = journal_topic(recording.info())
        assert topic is not None
        begins = cut_places(recording.spots(topic), random.choice((1, 1 << 15, 1 << 20)))
        self._found = {
            position: piece
            for begin, end in zip(begins, [*begins[1:], None], strict=True)
            if random.random() < 0.8
            for position, piece in confirmed_pieces(recording, topic, version, begin, end).items()
        }
        self.count = 0
        self.unused = sum(len(piece.unused) for piece in self._found.values())

    def confirmed(self, position: Position) -> ConfirmedPiece | None:
        self.count += position in self._found
        return self._found.get(position)

    def bytes_found(self) -> None:
        """Leave the bytes to the check."""


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> Contents:
    folder = tmp_path_factory.mktemp("honest")
    wrong = Odometry(Pose(0.0, 90.0, 0.0), Twist(), 0)  # a jump, which the kernel does not use
    requests: list[Event] = [drive_requested(), OdomReceived(BEGIN_NS + NS_PER_S + 5, wrong)]
    snapshots_s = (0.0, 0.8, 1.6, 2.4, 3.2)
    return heard_drive(folder / "run", 3.6, requests=requests, snapshots_s=snapshots_s)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory, honest: Contents) -> Path:
    return write_contents(tmp_path_factory.mktemp("written") / "run", honest)


def told(path: Path, **options: Any) -> dict[str, Any]:
    """Return the report without the time that the check took."""
    report = check_recording(path, **options).as_object()
    del report["took_s"]
    return report


def test_an_edited_recording_has_the_same_report_in_pieces(
    tmp_path: Path, honest: Contents, monkeypatch: pytest.MonkeyPatch
) -> None:
    random, confirmed, unused = Random(5), 0, 0
    kinds = [*FOUND.items(), *ONLY_IF_CLOSED.items(), ("honest", lambda contents, _: contents)]
    random.shuffle(kinds)
    for number, (name, kind) in enumerate(islice(cycle(kinds), EDITS)):
        try:
            edited = kind(honest, random)
        except IndexError:
            continue  # this recording has no such place
        path = write_contents(tmp_path / str(number) / "run", edited)
        whole = told(path)
        pools: list[Pieces] = []

        @contextmanager
        def in_pieces(
            recording: Recording, version: str, processes: int, pools: list[Pieces] = pools
        ) -> Iterator[Pieces | None]:
            if journal_topic(recording.info()) is not None:
                pools.append(Pieces(recording, version, random))
            yield pools[0] if pools else None

        with monkeypatch.context() as patch:
            patch.setattr(check_module, "pool_for", in_pieces)
            assert told(path) == whole, name
        confirmed += sum(pool.count for pool in pools)
        unused += sum(pool.unused for pool in pools)
    assert confirmed > EDITS
    assert unused > 0


def is_confirmed(path: Path) -> bool:
    """Return whether a process confirms a piece as this process does."""
    with Recording(path) as recording:
        topic = journal_topic(recording.info())
        assert topic is not None
        begin = recording.spots(topic)[0][0]
        pieces = confirmed_pieces(recording, topic, __version__, begin, None)
        jobs = sorted({Spot(position.file, position.offset) for position in pieces})
        places = [(spot, piece_pool.JOB_BYTES) for spot in jobs]
        position = min(each for each in pieces if each.offset == jobs[1].offset)
        begin_helper = partial(piece_pool.begin_helper, recording, topic, __version__)
        with PiecePool(begin_helper, places, 1, reads_bytes=False) as pool:
            until(lambda: pool.confirmed(position) is not None)
            return pool.confirmed(position) == pieces[position]


def test_processes_confirm_the_pieces_of_an_honest_recording(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = set(psutil.Process().children())
    monkeypatch.setattr(piece_pool, "has_one_thread", lambda: False)
    assert is_confirmed(recording)
    assert set(psutil.Process().children()) <= before


def test_copies_of_a_process_with_one_thread_confirm_them_as_well(recording: Path) -> None:
    program = f"""
from pathlib import Path
from robotctl.rerun import piece_pool
from tests.rerun.test_pieces import is_confirmed
assert piece_pool.has_one_thread()
piece_pool.start = None
print(is_confirmed(Path({str(recording)!r})))
"""
    ran = subprocess.run(
        [sys.executable, "-c", program],
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},  # of a library of the tests
        capture_output=True,
        text=True,
        timeout=2 * DEADLINE_S,
    )
    assert (ran.stdout, ran.stderr) == ("True\n", "")


def test_the_report_of_a_check_with_processes_is_that_of_one_alone(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = small_jobs(monkeypatch)
    report = told(recording, processes=2)
    assert report["verdict"] == Verdict.SAME
    assert report == told(recording)
    assert asked


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_process_that_is_killed_or_stopped_changes_nothing(
    recording: Path, monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    before = set(psutil.Process().children())
    monkeypatch.setattr(piece_pool, "BYTES_PATIENCE_S", 0.2)
    confirmed = small_jobs(monkeypatch, lambda child: os.kill(child, number))
    assert told(recording, processes=2) == told(recording)
    assert sum(confirmed) == 0
    assert set(psutil.Process().children()) <= before


def test_a_process_that_cannot_be_started_changes_nothing(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    confirmed = small_jobs(monkeypatch)

    def fail(*_: Any, **__: Any) -> None:
        raise OSError("no descriptors")

    monkeypatch.setattr(piece_pool, "fork", fail)
    monkeypatch.setattr(piece_pool, "start", fail)
    assert told(recording, processes=2) == told(recording)
    assert confirmed
    assert not any(confirmed)


def test_only_places_that_may_begin_a_piece_are_searched_for_one(recording: Path) -> None:
    with Recording(recording) as opened:
        topic = journal_topic(opened.info())
        assert topic is not None
        spots = [spot for spot, _ in opened.spots(topic)]
        nothing = list(opened.messages_from(topic, spots[0], lambda records: False))
        places = opened.messages_from(topic, spots[0], lambda records: b"Snapshot\0" in records)
        entries = [message.data for _, messages in places for message in messages or ()]
    assert nothing == [(spot, []) for spot in spots]
    assert sum(map(is_snapshot, entries)) == 6  # the last one ends the recording


class _StandingChild:
    """A process that takes jobs and does none."""

    def __init__(self) -> None:
        self.jobs: list[int] = []

    def send(self, line: bytes) -> None:
        if "job" in (sent := json.loads(line)):
            self.jobs.append(sent["job"])

    def receive(self, seconds: float) -> list[Any]:
        raise TimeoutError

    def kill(self) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""


def test_a_process_is_given_only_jobs_that_the_check_reaches_later(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    children: list[_StandingChild] = []

    def begin() -> Any:
        children.append(_StandingChild())
        return children[-1]

    places = [(Spot(0, offset), piece_pool.JOB_BYTES) for offset in range(10)]
    with PiecePool(begin, places, 1, reads_bytes=False) as pool:
        assert children[0].jobs == [1, 5, 9]
    with PiecePool(begin, places, 2, reads_bytes=False) as pool:
        assert [child.jobs for child in children[1:]] == [[1, 5, 9], [2, 6]]
        assert pool.confirmed(Position(0, 5, 0)) is None
    with PiecePool(begin, places[:2], 1, reads_bytes=False) as pool:
        assert children[-1].jobs == [1]


def small_jobs(
    monkeypatch: pytest.MonkeyPatch, at_start: Callable[[int], None] = lambda child: None
) -> list[bool]:
    """Cut recordings of any size at every place; return what the pool answers."""
    answers: list[bool] = []
    confirmed = PiecePool.confirmed

    def answer(pool: PiecePool, position: Position) -> ConfirmedPiece | None:
        piece = confirmed(pool, position)
        answers.append(piece is not None)
        return piece

    begin = piece_pool.begin_helper

    def begin_noted(*arguments: Any) -> Any:
        child = begin(*arguments)
        at_start(child.pid)
        return child

    monkeypatch.setattr(piece_pool, "LEAST_BYTES", 0)
    monkeypatch.setattr(piece_pool, "JOB_BYTES", 1)
    monkeypatch.setattr(PiecePool, "confirmed", answer)
    monkeypatch.setattr(piece_pool, "begin_helper", begin_noted)
    return answers
