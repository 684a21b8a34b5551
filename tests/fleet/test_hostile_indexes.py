"""An index is a file like any other: damaged, hostile, removed meanwhile, oddly named, cut off."""

from __future__ import annotations

import os
import resource
import shutil
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest

from robotctl.collection import catalogue as catalogues
from robotctl.collection import database as databases
from robotctl.collection.catalogue import CATALOGUE_NAME, catalogue_of, stamps_in
from robotctl.collection.database import database, parquet, write_parquet
from robotctl.collection.index_file import files_of, index_path, stamp_of
from robotctl.collection.indexing import index_recording
from robotctl.collection.questions import ask, find
from robotctl.daemon.recording.indexer import INDEX
from robotctl.errors import Refused
from robotctl.processes import start
from robotctl.processes.jobs import job_command
from robotctl.recording.format.names import derived_files
from robotctl.testing.drives import drive, record

pytest.importorskip("duckdb", reason="indexes are an extra: robotctl[parquet]")

NAME, OTHER = "robot_20260101_120000", "robot_20260102_120000"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made")
    for name in (NAME, OTHER):
        assert index_recording(record(folder / name, drive(2.0))) == ""
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    copied = tmp_path / "recordings"
    shutil.copytree(made, copied, copy_function=shutil.copy2)
    return copied


@pytest.fixture(autouse=True)
def indexed(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Index in this process, and return what was indexed."""
    done: list[str] = []

    def index_here(recordings: list[Path], *_: object) -> dict[Path, str]:
        done.extend(each.name for each in recordings)
        said = {each: index_recording(each) for each in recordings}
        return {each: text for each, text in said.items() if text}

    monkeypatch.setattr(catalogues, "index_recordings", index_here)
    return done


def recordings_found(folder: Path) -> list[str]:
    with catalogue_of(folder) as catalogue:
        rows = find(catalogue, "recordings", "").as_objects()
        assert ask(catalogue, "SELECT count(*) FROM samples").rows[0][0] > 0
    return [row["recording"] for row in rows]


def rewritten(index: Path, query: str) -> None:
    """Write other rows with the stamp of the index; `here` is the index in SQL."""
    write_parquet(index, query.replace("here", parquet([index])), [index])


@pytest.mark.parametrize(
    "query",
    [
        "SELECT * EXCLUDE (laps) FROM here",
        "SELECT * REPLACE (laps::VARCHAR AS laps) FROM here",
        "SELECT *, 1 AS more FROM here",
        'SELECT * EXCLUDE (laps), laps AS "LAPS " FROM here',
        "SELECT * FROM here WHERE kind <> 'recording'",
        "SELECT * REPLACE ('other' AS recording) FROM here",
    ],
)
def test_an_index_of_another_layout_is_made_again(
    folder: Path, indexed: list[str], query: str
) -> None:
    rewritten(index_path(folder / NAME), query)
    assert recordings_found(folder) == [NAME, OTHER]
    assert indexed == [NAME]


@pytest.mark.parametrize("kind", ["recording", "event"])
def test_an_index_with_too_many_rows_is_made_again(
    folder: Path, indexed: list[str], monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.setattr(catalogues, "MAX_ROWS", 1000)
    rewritten(
        index_path(folder / NAME),
        f"SELECT one.* FROM (SELECT * FROM here WHERE kind IN ('recording', '{kind}')) AS one, "
        "range(2000)",
    )
    assert recordings_found(folder) == [NAME, OTHER]
    assert indexed == [NAME]


def test_a_catalogue_that_somebody_else_wrote_is_made_again(folder: Path) -> None:
    elsewhere = folder / OTHER / CATALOGUE_NAME
    for wrong in (b"PAR1PAR1", elsewhere.read_bytes()[:-20]):
        (folder / CATALOGUE_NAME).write_bytes(wrong)
        assert recordings_found(folder) == [NAME, OTHER]
    (folder / CATALOGUE_NAME).unlink()
    os.mkfifo(folder / CATALOGUE_NAME)
    assert recordings_found(folder) == [NAME, OTHER]


def test_a_folder_in_the_place_of_an_index_is_named(folder: Path) -> None:
    index_path(folder / NAME).unlink()
    index_path(folder / NAME).mkdir()
    with catalogue_of(folder) as catalogue:
        (said,) = catalogue.left_out
        assert find(catalogue, "recordings", "").as_objects()[0]["recording"] == OTHER
    assert said.startswith(f"{NAME} is left out: cannot write ")


ODD_NAMES = ('it\'s "one"', "new\nline \x1b[31m", "büro 机器人", "run[1]", "a*b?", "kind=event")


def test_recordings_and_folders_may_have_any_name(folder: Path) -> None:
    for name in ODD_NAMES:
        shutil.copytree(folder / NAME, folder / name, copy_function=shutil.copy2)
    renamed = folder.rename(folder.with_name("".join(ODD_NAMES)))
    assert recordings_found(renamed) == sorted([*ODD_NAMES, NAME, OTHER])


def test_a_name_that_is_no_text_is_left_out(folder: Path) -> None:
    (folder / NAME).rename(folder / os.fsdecode(b"robot\xff"))
    with catalogue_of(folder) as catalogue:
        assert catalogue.left_out == ("robot\\udcff is left out: its name is no UTF-8",)
    with pytest.raises(Refused, match="no UTF-8"), catalogue_of(Path(os.fsdecode(b"\xff"))):
        pass


def test_a_recording_that_is_removed_meanwhile_is_left_out(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    index_path(folder / NAME).unlink()

    def remove(recordings: list[Path], *_: object) -> dict[Path, str]:
        shutil.rmtree(folder / NAME)
        return {}

    monkeypatch.setattr(catalogues, "index_recordings", remove)
    with catalogue_of(folder) as catalogue:
        assert f"{NAME} is left out: it was removed meanwhile" in catalogue.left_out
        shutil.rmtree(folder / OTHER)
        assert ask(catalogue, "SELECT count(*) FROM recordings").rows == ((1,),)


@contextmanager
def descriptors(count: int) -> Iterator[None]:
    """Let this process open so many descriptors only."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (count, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_without_descriptors_an_error_says_so(folder: Path) -> None:
    assert recordings_found(folder) == [NAME, OTHER]  # what is needed is imported
    with descriptors(3), pytest.raises(OSError, match="Too many open files"), catalogue_of(folder):
        pass
    assert recordings_found(folder) == [NAME, OTHER]


def kill_while_it_indexes(recording: Path, after_s: float) -> None:
    """Start to index a recording, kill the process, and expect a valid index or none."""
    index_path(recording).unlink(missing_ok=True)
    child = start(job_command(INDEX, {"recording": str(recording)}))
    child.wait(after_s)
    child.kill(signal.SIGKILL)
    child.close()
    left = {recording.name: stamp_of(files_of(recording))} if index_path(recording).exists() else {}
    assert stamps_in(index_path(recording)) == left
    made = {each.name for each in derived_files(recording)}
    assert {each.name for each in recording.iterdir()} - made == {
        "metadata.yaml",
        *map(os.path.basename, files_of(recording)),
    }


def test_a_kill_leaves_a_valid_index_or_none(folder: Path) -> None:
    for after_s in (0.1, 0.3):
        kill_while_it_indexes(folder / NAME, after_s)


@pytest.mark.slow
def test_a_kill_at_any_moment_leaves_a_valid_index_or_none(folder: Path) -> None:
    for number in range(100):
        kill_while_it_indexes(folder / NAME, 0.01 * number)


def test_the_database_prints_nothing_into_an_answer() -> None:
    with database() as connection:
        shown = connection.execute("SELECT current_setting('enable_progress_bar')")
        assert shown.fetchall() == [(False,)]


def test_what_a_killed_process_left_is_removed_later(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    left = folder / NAME / f".{CATALOGUE_NAME}.123.tmp"
    left.write_bytes(b"PAR1")
    assert left in derived_files(folder / NAME)
    assert index_recording(folder / NAME) == ""
    assert left.exists()  # its process may be at work
    monkeypatch.setattr(databases, "ABANDONED_S", -1.0)
    assert index_recording(folder / NAME) == ""
    assert not left.exists()


def test_a_full_disk_is_told_in_the_words_of_the_system(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = SimpleNamespace(f_bavail=0)
    monkeypatch.setattr(os, "fstatvfs", lambda descriptor: full)
    with pytest.raises(OSError, match="No space left on device"):
        write_parquet(tmp_path / "index.parquet", "SELECT * FROM what_is_cut_short", [])
