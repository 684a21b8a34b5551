"""The journal of decisions: append-only, bounded, tolerant of a torn end, and never in the way.

The journal of decisions removes whole files, the oldest first; what else is missing is told.
"""

from __future__ import annotations

import errno
import json
import os
import stat
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from robotctl.decisions import journal as files
from robotctl.decisions import log as writer
from robotctl.decisions.journal import MAX_TEXT, DecisionKind, LogContent, hash_of, read_log
from robotctl.decisions.log import DAY_BYTES, RESERVE_BYTES, DecisionLog
from robotctl.kernel.units import DAY_S

PATIENCE_S = 30.0
BEGIN_NS = 1_800_000_000_000_000_000


class Clock:
    """A wall clock and a steady clock that a test sets."""

    def __init__(self) -> None:
        self.s = 0.0

    def now_ns(self) -> int:
        return BEGIN_NS + round(self.s * 1e9)

    def steady_s(self) -> float:
        return self.s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "decisions"


@pytest.fixture
def begin(
    folder: Path, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[..., DecisionLog]]:
    """Return a function that makes a log; those that are left are closed at the end."""
    monkeypatch.setattr(writer, "END_S", PATIENCE_S)
    made: list[DecisionLog] = []

    def make(keep_s: float = 0.0) -> DecisionLog:
        log = DecisionLog(
            folder, keep_s, now_ns=clock.now_ns, steady_s=clock.steady_s, retry_s=0.01
        )
        made.append(log)
        return log

    yield make
    for log in made:
        log.close()


def written(folder: Path) -> list[tuple[str, dict[str, Any]]]:
    log = read_log(folder)
    assert log.broken == []
    return [(entry.kind, dict(entry.values)) for entry in log.entries]


def wait_for(condition: Callable[[], object]) -> None:
    """Wait until a condition of the writer's thread holds."""
    pause = threading.Event()
    for _ in range(round(PATIENCE_S / 0.01)):
        if condition():
            return
        pause.wait(0.01)
    raise AssertionError("the thread did not get there")


def test_entries_outlive_their_writer_in_order(
    begin: Callable[[], DecisionLog], folder: Path
) -> None:
    for round_ in range(3):
        log = begin()
        log.add(DecisionKind.MODE, to="ERROR", round=round_)
        log.add(DecisionKind.END)
        log.close()
    kinds = [kind for kind, _ in written(folder)]
    assert kinds == ["mode", "end"] * 3
    assert [values["round"] for kind, values in written(folder) if kind == "mode"] == [0, 1, 2]


def test_only_its_owner_may_read_it(begin: Callable[[], DecisionLog], folder: Path) -> None:
    before = os.umask(0)
    try:
        log = begin()
        log.add(DecisionKind.END)
        log.close()
    finally:
        os.umask(before)
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert {stat.S_IMODE(path.stat().st_mode) for path in files.files_of(folder)} == {0o600}


@pytest.mark.parametrize("cut", [1, 2, 20])
def test_a_torn_end_costs_the_torn_entry_only(
    begin: Callable[[], DecisionLog], folder: Path, cut: int
) -> None:
    log = begin()
    for number in range(3):
        log.add(DecisionKind.MODE, number=number)
    log.close()
    (path,) = files.files_of(folder)
    path.write_bytes(path.read_bytes()[:-cut])
    log = begin()
    log.add(DecisionKind.MODE, number=3)
    log.close()
    found = read_log(folder)
    assert found.broken == []
    kept = [0, 1, 2, 3] if cut == 1 else [0, 1, 3]  # 1: only the end of the line
    assert [entry.values["number"] for entry in found.entries] == kept
    assert len(found.notes) == (cut > 1)


def edited(path: Path, edit: Callable[[list[bytes]], list[bytes]]) -> LogContent:
    path.write_bytes(b"".join(line + b"\n" for line in edit(path.read_bytes().splitlines())))
    return read_log(path.parent)


@pytest.mark.parametrize(
    "edit",
    [
        lambda lines: [*lines[:1], *lines[2:]],
        lambda lines: [lines[0], lines[2], lines[1], lines[3]],
        lambda lines: [lines[0], lines[1].replace(b"ERROR", b"IDLE"), *lines[2:]],
        lambda lines: [*lines[:2], lines[1], *lines[2:]],
        lambda lines: [lines[0], b"garbage", *lines[2:]],
    ],
    ids=["removed", "swapped", "changed", "repeated", "overwritten"],
)
def test_an_edit_in_the_middle_is_found(
    begin: Callable[[], DecisionLog], folder: Path, edit: Callable[[list[bytes]], list[bytes]]
) -> None:
    log = begin()
    for number in range(4):
        log.add(DecisionKind.MODE, to="ERROR", number=number)
    log.close()
    (path,) = files.files_of(folder)
    assert read_log(folder).broken == []
    assert "does not follow" in edited(path, edit).broken[0]


def test_software_and_configuration_are_written_where_they_changed(
    begin: Callable[[], DecisionLog], folder: Path
) -> None:
    for version in ("1", "1", "2", "2"):
        log = begin()
        log.add(DecisionKind.START, by="a user")
        log.add_values(DecisionKind.SOFTWARE, {"robotctl": version, "kind": "not an entry's"})
        log.add_values(DecisionKind.CONFIGURATION, {"rate_hz": 50.0, "recording.include": ["/a"]})
        log.close()
    kinds = [kind for kind, _ in written(folder)]
    assert kinds == [
        *("start", "software", "configuration"),
        "start",
        *("start", "software"),
        "start",
    ]


def test_a_flood_is_counted_and_leaves_room_for_stops(
    begin: Callable[[], DecisionLog], folder: Path, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writer, "MAX_WAITING", 1 << 30)
    log = begin()
    flood = 5000
    for _ in range(flood):
        log.add(
            DecisionKind.REFUSED, asked="MOVING", by="a node that asks again and again", answer="no"
        )
    log.add(DecisionKind.MODE, to="EMERGENCY_STOP", reason="the operator")
    log.close()
    found = written(folder)
    assert ("mode", {"to": "EMERGENCY_STOP", "reason": "the operator"}) in found
    counted = sum(values["counts"]["refused"] for kind, values in found if kind == "more")
    assert counted + sum(kind == "refused" for kind, _ in found) == flood
    assert sum(path.stat().st_size for path in files.files_of(folder)) < DAY_BYTES


def test_whatever_happens_a_year_takes_50_mb_at_most() -> None:
    assert (DAY_BYTES + RESERVE_BYTES) * 366 < 50.2e6


def test_a_restart_gives_no_new_budget(
    begin: Callable[[], DecisionLog], folder: Path, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writer, "MAX_WAITING", 1 << 30)

    def day(restarts: int) -> None:
        for _ in range(restarts):
            log = begin()
            for _ in range(300):
                log.add(DecisionKind.MODE, to="ERROR", reason="x" * MAX_TEXT)
            log.close()
            clock.s += 60.0

    day(5)
    first = sum(path.stat().st_size for path in files.files_of(folder))
    assert first < DAY_BYTES + RESERVE_BYTES
    clock.s += DAY_S
    day(2)
    assert sum(path.stat().st_size for path in files.files_of(folder)) > first + DAY_BYTES / 2


def test_files_are_bounded_and_chained(
    begin: Callable[[], DecisionLog], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(files, "FILE_BYTES", 2000)
    monkeypatch.setattr(writer, "FILE_BYTES", 2000)
    log = begin()
    for number in range(40):
        log.add(DecisionKind.MODE, number=number, reason="r" * 100)
    log.close()
    made = files.files_of(folder)
    assert len(made) > 2
    assert max(path.stat().st_size for path in made) < 2300
    assert [values["number"] for _, values in written(folder)] == list(range(40))
    made[1].unlink()
    assert read_log(folder).broken


def test_only_files_that_are_years_old_are_removed(
    begin: Callable[..., DecisionLog], folder: Path, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(files, "FILE_BYTES", 100)
    monkeypatch.setattr(writer, "FILE_BYTES", 100)
    log = begin()
    for number in range(10):
        log.add(DecisionKind.MODE, number=number, reason="r" * 100)
    log.close()
    made = files.files_of(folder)
    age_s = 5 * 365 * DAY_S
    os.utime(made[0], (0, clock.now_ns() / 1e9 - age_s - 1))
    log = begin(age_s)
    log.add(DecisionKind.END)
    log.close()
    assert files.files_of(folder)[: len(made) - 1] == made[1:]
    found = read_log(folder)
    assert found.broken == []
    assert "before it are removed" in found.notes[0]


def test_a_full_disk_is_said_and_the_entries_follow_later(
    begin: Callable[[], DecisionLog], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = threading.Event()
    full.set()
    write = os.write

    def limited(descriptor: int, data: bytes) -> int:
        if not full.is_set() or threading.current_thread().name != "decisions":
            return write(descriptor, data)
        if len(data) > 30:
            return write(descriptor, data[:30])  # the disk takes a part of the line
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "write", limited)
    log = begin()
    log.add(DecisionKind.MODE, number=0)
    wait_for(log.warning)
    assert "No space left on device" in log.warning()
    log.add(DecisionKind.MODE, number=1)
    full.clear()
    wait_for(lambda: not log.warning() and len(read_log(folder).entries) == 2)
    log.close()
    assert [values["number"] for _, values in written(folder)] == [0, 1]


def test_counts_that_could_not_be_written_follow_later(
    begin: Callable[[], DecisionLog], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writer, "MAX_WAITING", 1 << 30)
    failed: list[bytes] = []
    write = os.write

    def once_full(descriptor: int, data: bytes) -> int:
        if b'"kind":"more"' in data and not failed:
            failed.append(data)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(descriptor, data)

    monkeypatch.setattr(os, "write", once_full)
    log = begin()
    flood = 3000
    for _ in range(flood):
        log.add(DecisionKind.REFUSED, asked="MOVING", by="a node that asks for ever", answer="no")
    wait_for(lambda: failed)
    log.close()
    counts = [values["counts"]["refused"] for kind, values in written(folder) if kind == "more"]
    assert sum(counts) + sum(kind == "refused" for kind, _ in written(folder)) == flood


def test_a_disk_that_hangs_delays_nobody(
    begin: Callable[[], DecisionLog], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    go_on = threading.Event()
    fsync = os.fsync

    def slow(descriptor: int) -> None:
        if threading.current_thread().name == "decisions":
            assert go_on.wait(PATIENCE_S)
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", slow)
    monkeypatch.setattr(writer, "MAX_WAITING", 10)
    monkeypatch.setattr(writer, "END_S", 0.01)
    log = begin()
    added = 100
    for number in range(added):
        log.add(DecisionKind.MODE, number=number)
    log.close()  # does not wait for the disk
    go_on.set()
    monkeypatch.setattr(writer, "END_S", PATIENCE_S)
    log.close()
    counts = [values["counts"] for kind, values in written(folder) if kind == "more"]
    modes = sum(kind == "mode" for kind, _ in written(folder))
    assert modes + sum(sum(each.values()) for each in counts) == added


@pytest.mark.parametrize("planted", ["fifo", "link", "folder"])
def test_what_stands_in_the_place_of_a_file_is_said_and_not_written(
    begin: Callable[[], DecisionLog], folder: Path, tmp_path: Path, planted: str
) -> None:
    folder.mkdir(mode=0o700)
    place = folder / "decisions-000001.jsonl"
    if planted == "fifo":
        os.mkfifo(place)
    elif planted == "link":
        place.symlink_to(tmp_path / "elsewhere")
    else:
        place.mkdir()
    log = begin()
    log.add(DecisionKind.END)
    wait_for(log.warning)
    assert str(folder) in log.warning()
    assert not (tmp_path / "elsewhere").exists()


def test_lines_of_a_later_version_are_kept_in_the_chain(
    begin: Callable[[], DecisionLog], folder: Path
) -> None:
    log = begin()
    log.add(DecisionKind.MODE, number=0)
    log.close()
    (path,) = files.files_of(folder)
    later = {"time_ns": 1, "kind": "later", "prev": hash_of(path.read_bytes().splitlines()[-1])}
    with path.open("a") as file:
        file.write(json.dumps(later) + "\n")
    log = begin()
    log.add(DecisionKind.END)
    log.close()
    assert [kind for kind, _ in written(folder)] == ["mode", "later", "end"]


@pytest.mark.parametrize(
    "line", [b"[]", b"{}", b"null", b"\xff", b"[" * 10_000, b'{"time_ns":"1"}', b"x" * 100_000]
)
def test_a_line_of_any_bytes_is_a_note(
    begin: Callable[[], DecisionLog], folder: Path, line: bytes
) -> None:
    log = begin()
    log.add(DecisionKind.END)
    log.close()
    (path,) = files.files_of(folder)
    path.write_bytes(path.read_bytes() + line + b"\n")
    found = read_log(folder)
    assert (len(found.entries), len(found.notes), found.broken) == (1, 1, [])


@pytest.fixture
def several(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """The files of a journal of several files."""
    monkeypatch.setattr(files, "FILE_BYTES", 300)
    monkeypatch.setattr(writer, "FILE_BYTES", 300)
    monkeypatch.setattr(writer, "END_S", 30.0)
    log = DecisionLog(tmp_path / "decisions", 0.0)
    for number in range(10):
        log.add(DecisionKind.MODE, number=number, reason="r" * 50)
    log.close()
    return files.files_of(tmp_path / "decisions")


def first_lines(made: list[Path]) -> None:
    made[0].write_bytes(b"".join(made[0].read_bytes().splitlines(keepends=True)[1:]))


def all_but_the_last_file(made: list[Path]) -> None:
    for path in made[:-1]:
        path.unlink()


def all_and_the_last_is_called_the_first(made: list[Path]) -> None:
    all_but_the_last_file(made)
    made[-1].rename(made[0])


def the_chain_begins_in_a_later_file(made: list[Path]) -> None:
    for number, path in reversed(list(enumerate(made, 2))):
        path.rename(path.with_name(f"decisions-{number:06}.jsonl"))


def test_whole_files_at_the_beginning_are_removed_with_a_note(
    several: list[Path],
) -> None:
    assert len(several) > 3
    assert read_log(several[0].parent).notes == []
    several[0].unlink()
    found = read_log(several[0].parent)
    assert (found.broken, found.begins_later) == ([], True)
    assert found.notes == [f"{several[1].name}: the entries before it are removed"]


@pytest.mark.parametrize(
    "remove",
    [
        first_lines,
        all_but_the_last_file,
        all_and_the_last_is_called_the_first,
        the_chain_begins_in_a_later_file,
    ],
)
def test_entries_that_the_journal_never_removes_itself_break_it(
    several: list[Path], remove: Callable[[list[Path]], None]
) -> None:
    remove(several)
    (sentence,) = read_log(several[0].parent).broken
    assert "entries before its first one were removed, not by robotctl" in sentence
