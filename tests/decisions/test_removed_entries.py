"""The journal of decisions removes whole files, the oldest first; what else is missing is told."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from robotctl.decisions import journal as files
from robotctl.decisions import log as writer
from robotctl.decisions.journal import DecisionKind, read_log
from robotctl.decisions.log import DecisionLog


@pytest.fixture
def made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
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


def test_whole_files_at_the_beginning_are_removed_with_a_note(made: list[Path]) -> None:
    assert len(made) > 3
    assert read_log(made[0].parent).notes == []
    made[0].unlink()
    found = read_log(made[0].parent)
    assert (found.broken, found.begins_later) == ([], True)
    assert found.notes == [f"{made[1].name}: the entries before it are removed"]


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
    made: list[Path], remove: Callable[[list[Path]], None]
) -> None:
    remove(made)
    (sentence,) = read_log(made[0].parent).broken
    assert "entries before its first one were removed, not by robotctl" in sentence
