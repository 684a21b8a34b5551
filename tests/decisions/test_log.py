"""The journal of decisions: append-only, bounded, tolerant of a torn end, and never in the way.

It removes whole files, the oldest first, but no line about a sealed file; what else is missing or
changed before such a line is told. Several processes may append to it at once.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
import stat
import threading
from collections.abc import Callable, Iterator
from hashlib import sha256
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import pytest

from robotctl.base.paths import make_private
from robotctl.decisions import journal as files
from robotctl.decisions import log as writer
from robotctl.decisions.journal import MAX_TEXT, DecisionKind, log_folder, read_log
from robotctl.decisions.log import DAY_BYTES, RESERVE_BYTES, DecisionLog
from robotctl.kernel.constants import DAY_S
from robotctl.recording.seal import Keyring, known_heads, wrong_openings
from tests.support.waiting import until

Begin = Callable[..., DecisionLog]

PATIENCE_S = 30.0
GOLDEN_STATE = Path(__file__).parents[1] / "golden" / "sealed_state"
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
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    return make_private(log_folder("robot"))


@pytest.fixture
def begin(folder: Path, clock: Clock, monkeypatch: pytest.MonkeyPatch) -> Iterator[Begin]:
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


def write_end(log: DecisionLog) -> None:
    log.add(DecisionKind.END)
    log.close()


def test_entries_outlive_their_writer_in_order_and_only_their_owner_reads_them(
    begin: Begin, folder: Path
) -> None:
    before = os.umask(0)
    for round_ in range(3):
        log = begin()
        log.add(DecisionKind.MODE, to="ERROR", round=round_)
        log.add(DecisionKind.END)
        log.close()
    os.umask(before)
    kinds, values = zip(*written(folder), strict=True)
    assert kinds == ("mode", "end") * 3
    assert [each["round"] for each in values[::2]] == [0, 1, 2]
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert {stat.S_IMODE(path.stat().st_mode) for path in files.files_of(folder)} == {0o600}


@pytest.mark.parametrize("cut", [1, 2, 20])
def test_a_torn_end_costs_the_torn_entry_only(begin: Begin, folder: Path, cut: int) -> None:
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


@pytest.fixture
def keys(folder: Path) -> Keyring:
    return Keyring(folder.with_name("seal"), "robot")


def broken(folder: Path) -> list[str]:
    """Return what `evidence` finds in the journal."""
    log = read_log(folder)
    return [*log.broken, *wrong_openings(log.opened)]


def signed_by_nobody(lines: list[bytes]) -> list[bytes]:
    lines[1] = lines[1].replace(b"ERROR", b"IDLE")
    before = b"".join(line + b"\n" for line in lines[:3])
    opened = json.loads(lines[3]) | {"journal": [sha256(before).hexdigest()]}
    return [*lines[:3], json.dumps(opened).encode()]


@pytest.mark.parametrize(
    "edit",
    [
        lambda lines: [*lines[:1], *lines[2:]],
        lambda lines: [lines[0], lines[1].replace(b"ERROR", b"IDLE"), *lines[2:]],
        lambda lines: [lines[0], b"garbage", *lines[2:]],
        lambda lines: [*lines[:3], lines[3].replace(b'"signature"', b'"other"')],
        signed_by_nobody,
    ],
    ids=["removed", "changed", "overwritten", "not signed", "signed by nobody"],
)
def test_an_edit_before_an_opening_is_found(
    begin: Begin, folder: Path, keys: Keyring, edit: Callable[[list[bytes]], list[bytes]]
) -> None:
    log = begin()
    for number in range(3):
        log.add(DecisionKind.MODE, to="ERROR", number=number)
    log.close()
    keys.open_file("run_0")
    assert broken(folder) == []
    (path,) = files.files_of(folder)
    path.write_bytes(b"".join(line + b"\n" for line in edit(path.read_bytes().splitlines())))
    (sentence,) = broken(folder)
    assert "does not sign the lines before it" in sentence


def test_an_opening_signs_a_torn_line_and_old_lines_too(
    begin: Begin, folder: Path, keys: Keyring
) -> None:
    old, torn = b'{"time_ns":1,"kind":"start","prev":""}\n', b'{"time_ns":2,"kind":"end","prev":"01'
    (folder / "decisions-000001.jsonl").write_bytes(old + torn)
    keys.open_file("run_0")
    write_end(begin())
    assert broken(folder) == []
    (path,) = files.files_of(folder)
    path.write_bytes(path.read_bytes().replace(b'"prev":"01', b'"prev":"02'))
    assert len(broken(folder)) == 1


def append_many(folder: Path, name: str, count: int) -> None:
    """Append entries and openings of files, as a daemon does."""
    log = DecisionLog(folder, 0.0)
    keys = Keyring(folder.with_name("seal"), "robot")
    for number in range(count):
        log.add(DecisionKind.MODE, by=name, number=number)
        if number % 5 == 0:
            keys.open_file(f"{name}_{number}")
    log.close()


def test_two_processes_append_at_once_and_a_third_is_killed(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    context = get_context("fork")
    monkeypatch.setattr(files, "FILE_BYTES", 20_000)
    monkeypatch.setattr(writer, "END_S", PATIENCE_S)
    one, two, killed = (
        context.Process(target=append_many, args=(folder, name, count))
        for name, count in (("one", 100), ("two", 100), ("killed", 1 << 30))
    )
    for process in (one, two, killed):
        process.start()
    one.join(PATIENCE_S)
    killed.kill()
    two.join(PATIENCE_S)
    killed.join(PATIENCE_S)
    assert (one.exitcode, two.exitcode) == (0, 0)
    for process in (one, two, killed):
        process.close()
    assert broken(folder) == []
    log = read_log(folder)
    for name in ("one", "two"):
        mine = [each.values["number"] for each in log.entries if each.values["by"] == name]
        assert mine == list(range(100))
    opened = [line.entry.values["opened"]["file"] for line in log.opened]
    assert {f"{name}_{n}" for name in ("one", "two") for n in range(0, 100, 5)} <= {*opened}
    assert len(log.files) > 2


def test_software_and_configuration_are_written_where_they_changed(
    begin: Begin, folder: Path
) -> None:
    for version in ("1", "1", "2", "2"):
        log = begin()
        log.add(DecisionKind.START, by="a user")
        log.add_values(DecisionKind.SOFTWARE, {"robotctl": version, "kind": "not an entry's"})
        log.add_values(DecisionKind.CONFIGURATION, {"rate_hz": 50.0, "recording.include": ["/a"]})
        log.close()
    kinds = " ".join(kind for kind, _ in written(folder))
    assert kinds == "start software configuration start start software start"


def test_a_flood_is_counted_and_leaves_room_for_stops(
    begin: Begin, folder: Path, monkeypatch: pytest.MonkeyPatch
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
    flood, asker = 5000, "a node that asks again and again"
    for _ in range(flood):
        log.add(DecisionKind.REFUSED, asked="MOVING", by=asker, answer="no")
    log.add(DecisionKind.MODE, to="EMERGENCY_STOP", reason="the operator")
    until(lambda: failed)
    log.close()
    found = written(folder)
    assert ("mode", {"to": "EMERGENCY_STOP", "reason": "the operator"}) in found
    counted = sum(values["counts"]["refused"] for kind, values in found if kind == "more")
    assert counted + sum(kind == "refused" for kind, _ in found) == flood
    assert sum(path.stat().st_size for path in files.files_of(folder)) < DAY_BYTES


def test_whatever_happens_a_year_takes_50_mb_at_most() -> None:
    assert (DAY_BYTES + RESERVE_BYTES) * 366 < 50.2e6


def test_lines_about_sealed_files_take_nothing_of_the_budget(
    folder: Path, keys: Keyring, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writer, "DAY_BYTES", 400)
    keys.open_file("run_0")
    log = DecisionLog(folder, 0.0)
    log.add(DecisionKind.MODE, to="ERROR")
    log.close()
    assert written(folder) == [("mode", {"to": "ERROR"})]


def test_a_restart_gives_no_new_budget(
    begin: Begin, folder: Path, clock: Clock, monkeypatch: pytest.MonkeyPatch
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


def test_only_files_that_are_years_old_are_removed_and_no_line_about_a_sealed_file(
    begin: Begin, folder: Path, keys: Keyring, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(files, "FILE_BYTES", 100)
    opened = keys.open_file("run_0").opening
    log = begin()
    for number in range(10):
        log.add(DecisionKind.MODE, number=number, reason="r" * 100)
    log.close()
    made = files.files_of(folder)
    age_s = 5 * 365 * DAY_S
    os.utime(made[0], (0, clock.now_ns() / 1e9 - age_s - 1))
    write_end(begin(age_s))
    assert files.files_of(folder)[: len(made) - 1] == made[1:]
    assert broken(folder) == []
    assert "before it are removed" in read_log(folder).notes[0]
    assert known_heads().opened == {opened.key: opened}


def test_the_list_of_an_early_version_is_taken_over_whatever_interrupts_it(
    folder: Path, keys: Keyring, monkeypatch: pytest.MonkeyPatch
) -> None:
    heads = folder.with_name("seal")
    old = heads / "heads.jsonl"
    shutil.copytree(GOLDEN_STATE / "seal", heads, copy_function=shutil.copyfile)
    said, write = known_heads(), os.write
    assert len(said.opened) == 7
    monkeypatch.setattr(os, "write", lambda fd, data: write(fd, data[:700]))  # the disk is full
    with pytest.raises(OSError, match="No space left"):
        keys.open_file("run_0")
    monkeypatch.setattr(os, "write", write)
    assert known_heads() == said
    list_ = old.read_bytes()
    keys.rotate()
    assert not old.exists()
    old.write_bytes(list_)  # as if it was killed before the list was renamed
    assert known_heads() == said
    opened = keys.open_file("run_0").opening
    assert (old.exists(), old.with_name("heads.jsonl.old").read_bytes()) == (False, list_)
    said.opened[opened.key] = opened
    assert known_heads().opened == said.opened
    assert (broken(folder), read_log(folder).notes) == ([], [])


def test_a_full_disk_is_said_and_the_entries_follow_later(
    begin: Begin, folder: Path, monkeypatch: pytest.MonkeyPatch
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
    until(log.warning)
    assert "No space left on device" in log.warning()
    log.add(DecisionKind.MODE, number=1)
    full.clear()
    until(lambda: not log.warning() and len(read_log(folder).entries) == 2)
    log.close()
    assert [values["number"] for _, values in written(folder)] == [0, 1]


def test_a_disk_that_hangs_delays_nobody(
    begin: Begin, folder: Path, monkeypatch: pytest.MonkeyPatch
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


@pytest.mark.parametrize("planted", ["fifo", "link", "folder", "file of another user"])
def test_what_stands_in_the_place_of_a_file_is_said_and_not_written(
    begin: Begin, folder: Path, tmp_path: Path, planted: str
) -> None:
    place, elsewhere = folder / "decisions-000001.jsonl", tmp_path / "elsewhere"
    elsewhere.touch()
    match planted:
        case "fifo":
            os.mkfifo(place)
        case "link":
            place.symlink_to(elsewhere)
        case "folder":
            place.mkdir()
        case _ if os.getuid() == 0:
            os.link(elsewhere, place)
            os.chown(place, 12345, 12345)
        case _:
            pytest.skip("only root makes a file of another user")
    log = begin()
    log.add(DecisionKind.END)
    until(log.warning)
    assert str(folder) in log.warning()
    assert elsewhere.read_bytes() == b""


@pytest.mark.parametrize(
    "line", [b"[]", b"{}", b"null", b"\xff", b"[" * 10_000, b'{"time_ns":"1"}', b"x" * 100_000]
)
def test_a_line_of_any_bytes_is_a_note_and_one_of_a_later_version_an_entry(
    begin: Begin, folder: Path, line: bytes
) -> None:
    (folder / "decisions-000001.jsonl").write_bytes(line + b'\n{"time_ns":1,"kind":"later"}\n')
    write_end(begin())
    assert [kind for kind, _ in written(folder)] == ["later", "end"]
    assert len(read_log(folder).notes) == 1


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda made: made[1].unlink(), "a file between others was removed, not by robotctl"),
        (lambda made: [path.unlink() for path in made[:-1]], "before it were removed, not"),
        (lambda made: made[-2].write_bytes(b""), "does not sign the lines before it"),
    ],
)
def test_files_that_the_journal_never_changes_itself_break_it(
    begin: Begin,
    folder: Path,
    keys: Keyring,
    monkeypatch: pytest.MonkeyPatch,
    change: Callable[[list[Path]], object],
    says: str,
) -> None:
    monkeypatch.setattr(files, "FILE_BYTES", 2000)
    log = begin()
    for number in range(40):
        log.add(DecisionKind.MODE, number=number, reason="r" * 100)
    log.close()
    assert [values["number"] for _, values in written(folder)] == list(range(40))
    made = files.files_of(folder)
    assert max(path.stat().st_size for path in made) < 2300
    keys.open_file("run_0")
    assert broken(folder) == []
    change(made)
    assert says in broken(folder)[-1]
