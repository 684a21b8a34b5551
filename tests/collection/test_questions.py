"""`robotctl index` and `find`: answers over many recordings, from indexes that may be hostile."""

from __future__ import annotations

import errno
import os
import re
import resource
import shutil
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import IO, Any

import pytest

from robotctl.base import files
from robotctl.base.errors import Refused, UnreadableFile, UsageError
from robotctl.base.jobs import job_command
from robotctl.base.processes import start
from robotctl.collection import catalogue as catalogues
from robotctl.collection import index_file as databases
from robotctl.collection import questions
from robotctl.collection.catalogue import CATALOGUE_NAME, Catalogue, catalogue_of, stamps_in
from robotctl.collection.index_file import files_of, index_path, stamp_of
from robotctl.collection.indexing import index_recording
from robotctl.collection.questions import Answer, ask, find, parse_condition
from robotctl.daemon.recording.housekeeping import INDEX
from robotctl.kernel.types import ModeRequested
from robotctl.recording import Recorder, Recording
from robotctl.recording.format.disk import replaced_file
from robotctl.recording.format.names import derived_files
from robotctl.testing.drives import BEGIN_NS, TWIST, drive, drive_requested, record
from tests.support.cases import for_each

pytest.importorskip("duckdb", reason="indexes are an extra: robotctl[parquet]")

LAP, STOPPED = "robot_20260101_120000", "robot_20260102_120000"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a lap and a drive that an emergency stop ended, both indexed."""
    folder = tmp_path_factory.mktemp("fleet")
    record(folder / LAP, drive(20.0, requests=[drive_requested(laps=1)]))
    stop = ModeRequested(BEGIN_NS + 2_000_000_000, 2, 3, "robotctl estop")
    again = ModeRequested(BEGIN_NS + 2_500_000_000, 3, 1, "operator")
    record(folder / STOPPED, drive(3.0, requests=[drive_requested(), stop, again]))
    for name in (LAP, STOPPED):
        assert index_recording(folder / name) == ""
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    """Return a copy of it, without a catalogue, that a test may change."""
    copied = shutil.copytree(made, tmp_path / "recordings", copy_function=shutil.copy2)
    (Path(copied) / CATALOGUE_NAME).unlink(missing_ok=True)
    return Path(copied)


@pytest.fixture(autouse=True)
def indexed(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Index in this process, and return what was indexed; tests/cli does it in others."""
    done: list[str] = []

    def index_here(recordings: list[Path], *_: object) -> dict[Path, str]:
        done.extend(each.name for each in recordings)
        said = {each: index_recording(each) for each in recordings}
        return {each: text for each, text in said.items() if text}

    monkeypatch.setattr(catalogues, "index_recordings", index_here)
    return done


@pytest.fixture(scope="module")
def catalogue(made: Path) -> Iterator[Catalogue]:
    with catalogue_of(made) as opened:
        yield opened


def values(found: Answer, column: str) -> list[object]:
    return [row[column] for row in found.as_objects()]


def test_rows_are_sorted_and_limited(catalogue: Catalogue) -> None:
    assert values(find(catalogue, "drives", "", "-laps"), "recording") == [LAP, STOPPED]
    assert values(find(catalogue, "drives", "", "duration_s", 1), "recording") == [STOPPED]
    with pytest.raises(UsageError, match="did you mean laps"):
        find(catalogue, "drives", "", "lap")


@for_each(
    ("condition", "says"),
    [
        ("lapz > 1", "no column 'lapz': did you mean laps?"),
        ("laps = 1", "compare with =="),
        ("laps > 1; DROP TABLE x", "is not a condition"),
        ("__import__('os').system('true')", "is not a condition"),
        ("laps > (SELECT 1)", "is not a condition"),
        ("[1][0] == laps", "is not a condition"),
        ("laps > 1 and " * 200 + "laps > 1", "more than 2000 characters"),
        ("(" * 900 + "laps" + ")" * 900, "is not a condition"),
        ("\0", "is not a condition"),
    ],
)
def test_a_wrong_condition_is_named(condition: str, says: str) -> None:
    with pytest.raises(UsageError, match=re.escape(says)):
        parse_condition(condition, ("laps",))


def test_texts_of_a_condition_are_never_sql(catalogue: Catalogue) -> None:
    assert find(catalogue, "drives", "pattern == \"x' OR '1' = '1\"").rows == ()


@pytest.mark.parametrize(
    "query",
    [
        "SELECT * FROM read_csv('/etc/passwd')",
        "SELECT * FROM '/etc/hostname'",
        "COPY drives TO '/tmp/stolen.csv'",
        "INSTALL httpfs",
        "SET enable_external_access = true",
        "ATTACH '/tmp/other.db'",
        "SELECT nothing FROM drives",
        "SELECT * FROM query",  # a variable of the Python code
        "",
        "SELECT 1; SELECT 2",
    ],
)
def test_a_query_reads_the_indexes_and_nothing_else(catalogue: Catalogue, query: str) -> None:
    with pytest.raises(UsageError, match="cannot be answered"):
        ask(catalogue, query)


WRITING = (
    "COPY (SELECT 1 AS samples) TO 'INDEX' (USE_TMP_FILE false)",
    "WITH a AS (COPY (SELECT 1 AS samples) TO 'INDEX' (USE_TMP_FILE false)) SELECT * FROM a",
    "SELECT 1; COPY (SELECT 1 AS samples) TO 'INDEX' (USE_TMP_FILE false)",
    "SELECT 1 AS samples) TO 'INDEX' (USE_TMP_FILE false)",
    "PREPARE p AS COPY (SELECT 1 AS samples) TO 'INDEX' (USE_TMP_FILE false); EXECUTE p",
    "EXPLAIN ANALYZE COPY (SELECT 1 AS samples) TO 'INDEX' (USE_TMP_FILE false)",
)


def test_a_query_writes_into_no_index(folder: Path) -> None:
    with catalogue_of(folder) as opened:
        for target in (Path(opened.indexes[0]), opened.path):
            before = target.read_bytes()
            for query in WRITING:
                with pytest.raises(UsageError, match="cannot be answered"):
                    ask(opened, query.replace("INDEX", str(target)))
                assert target.read_bytes() == before, query


@pytest.mark.parametrize(
    "query",
    [
        "SELECT count(*) FROM drives; -- of all",
        "WITH d AS (SELECT * FROM drives) SELECT count(*) FROM d",
        "FROM drives SELECT count(*) /* of all */",
        "SELECT count(DISTINCT recording) FROM SAMPLES",
    ],
)
def test_a_query_may_be_written_in_any_form_that_selects(catalogue: Catalogue, query: str) -> None:
    assert ask(catalogue, query).rows == ((2,),)


@pytest.mark.parametrize("gone", ["an index", "the catalogue"])
def test_an_index_that_is_removed_meanwhile_is_one_sentence(
    folder: Path, gone: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with catalogue_of(folder) as opened:
        removed = Path(opened.indexes[0] if gone == "an index" else opened.path)

        def database_after_the_removal(files: Sequence[Path | str]) -> Any:
            removed.unlink()  # it goes after it was looked for
            return databases.database(files)

        monkeypatch.setattr(questions, "database", database_after_the_removal)
        with pytest.raises(Refused, match="an index cannot be read any more"):
            ask(opened, "SELECT count(*) FROM samples")


def test_only_what_has_changed_is_indexed_again(folder: Path, indexed: list[str]) -> None:
    with catalogue_of(folder):
        assert indexed == []
    before = (folder / CATALOGUE_NAME).stat().st_ino
    with catalogue_of(folder):
        assert (folder / CATALOGUE_NAME).stat().st_ino == before
    (file,) = (folder / LAP).glob("*.mcap")
    os.utime(file)
    shutil.rmtree(folder / STOPPED)
    with catalogue_of(folder) as opened:
        assert indexed == [LAP]
        assert values(find(opened, "recordings", ""), "recording") == [LAP]


def test_an_index_of_another_kind_or_content_is_made_again(
    folder: Path, indexed: list[str]
) -> None:
    index_path(folder / LAP).write_bytes(b"PAR1 is not enough")
    index_path(folder / STOPPED).unlink()
    index_path(folder / STOPPED).symlink_to(index_path(folder / LAP))
    (folder / CATALOGUE_NAME).write_bytes(b"")
    with catalogue_of(folder) as opened:
        assert sorted(indexed) == [LAP, STOPPED]
        assert len(find(opened, "drives", "").rows) == 2
    assert not index_path(folder / STOPPED).is_symlink()
    assert (folder / CATALOGUE_NAME).stat().st_mode & 0o077 == 0
    assert index_path(folder / LAP).stat().st_mode & 0o077 == 0


def test_what_cannot_be_indexed_is_left_out_and_named(folder: Path) -> None:
    (folder / "broken_1").mkdir()
    (folder / "broken_1" / "broken_1_0.mcap").write_bytes(b"no MCAP")
    live = Recorder(folder / "robot_20260103_120000", on_failure=pytest.fail)
    live.add_topic(TWIST)
    try:
        with catalogue_of(folder) as opened:
            assert values(find(opened, "recordings", ""), "recording") == [LAP, STOPPED]
            broken, recorded = sorted(opened.left_out)
        assert broken.startswith("broken_1 is left out: ")
        assert recorded == "robot_20260103_120000 is left out: it is being recorded"
    finally:
        live.close()


def test_a_read_only_folder_is_read(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = set(folder.iterdir())

    @contextmanager
    def replaced(target: Path) -> Iterator[IO[bytes]]:
        if target.parent == folder:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        with replaced_file(target) as stream:
            yield stream

    monkeypatch.setattr(databases, "replaced_file", replaced)
    with catalogue_of(folder) as opened:
        assert len(find(opened, "drives", "").rows) == 2
    assert set(folder.iterdir()) == before
    assert not opened.path.exists()


def test_an_empty_folder_has_no_rows(tmp_path: Path) -> None:
    with catalogue_of(tmp_path) as opened:
        assert find(opened, "drives", "laps > 0").rows == ()
        with pytest.raises(UsageError):
            ask(opened, "SELECT * FROM samples")


@pytest.mark.parametrize(("seconds", "fixed_bytes"), [(1.0, 14_000), (60.0, 5_000)])
def test_an_index_has_a_fiftieth_of_the_size_and_that_of_a_short_drive_some_kilobytes_more(
    tmp_path: Path, seconds: float, fixed_bytes: int
) -> None:
    recording = record(tmp_path / LAP, drive(seconds))
    assert index_recording(recording) == ""
    size = sum(each.stat().st_size for each in recording.glob("*.mcap"))
    assert index_path(recording).stat().st_size <= fixed_bytes + 0.02 * size


def test_an_unreadable_recording_says_why(tmp_path: Path) -> None:
    (tmp_path / "file.mcap").write_bytes(b"x" * 100)
    said = index_recording(tmp_path / "file.mcap")
    with pytest.raises(UnreadableFile) as raised:
        Recording(tmp_path / "file.mcap").__enter__()
    assert said.split(":")[0] == str(raised.value).split(":")[0]


def recordings_found(folder: Path) -> list[str]:
    with catalogue_of(folder) as catalogue:
        rows = find(catalogue, "recordings", "").as_objects()
        assert ask(catalogue, "SELECT count(*) FROM samples").rows[0][0] > 0
    return [row["recording"] for row in rows]


def rewritten(index: Path, query: str) -> None:
    """Write other rows with the stamp of the index; `here` is the index in SQL."""
    databases.write_parquet(index, query.replace("here", databases.parquet([index])), [index])


@pytest.mark.parametrize(
    "query",
    [
        "SELECT * REPLACE (laps::VARCHAR AS laps) FROM here",
        'SELECT * EXCLUDE (laps), laps AS "LAPS " FROM here',
        "SELECT * FROM here WHERE kind <> 'recording'",
        "SELECT * REPLACE ('other' AS recording) FROM here",
    ],
)
def test_an_index_of_another_layout_is_made_again(
    folder: Path, indexed: list[str], query: str
) -> None:
    rewritten(index_path(folder / LAP), query)
    assert recordings_found(folder) == [LAP, STOPPED]
    assert indexed == [LAP]


@pytest.mark.parametrize("kind", ["recording", "event"])
def test_an_index_with_too_many_rows_is_made_again(
    folder: Path, indexed: list[str], monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.setattr(catalogues, "MAX_ROWS", 1000)
    rewritten(
        index_path(folder / LAP),
        f"SELECT one.* FROM (SELECT * FROM here WHERE kind IN ('recording', '{kind}')) AS one, "
        "range(2000)",
    )
    assert recordings_found(folder) == [LAP, STOPPED]
    assert indexed == [LAP]


def test_a_catalogue_that_somebody_else_wrote_is_made_again(folder: Path) -> None:
    elsewhere = folder / STOPPED / CATALOGUE_NAME
    for wrong in (b"PAR1PAR1", elsewhere.read_bytes()[:-20]):
        (folder / CATALOGUE_NAME).write_bytes(wrong)
        assert recordings_found(folder) == [LAP, STOPPED]
    (folder / CATALOGUE_NAME).unlink()
    os.mkfifo(folder / CATALOGUE_NAME)
    assert recordings_found(folder) == [LAP, STOPPED]


def test_a_folder_in_the_place_of_an_index_is_named(folder: Path) -> None:
    index_path(folder / LAP).unlink()
    index_path(folder / LAP).mkdir()
    with catalogue_of(folder) as catalogue:
        (said,) = catalogue.left_out
        assert find(catalogue, "recordings", "").as_objects()[0]["recording"] == STOPPED
    assert said.startswith(f"{LAP} is left out: cannot write ")


ODD_NAMES = ('it\'s "one"', "new\nline \x1b[31m", "büro 机器人", "run[1]", "a*b?", "kind=event")


def test_recordings_and_folders_may_have_any_name(folder: Path) -> None:
    for name in ODD_NAMES:
        shutil.copytree(folder / STOPPED, folder / name, copy_function=shutil.copy2)
    renamed = folder.rename(folder.with_name("".join(ODD_NAMES)))
    assert recordings_found(renamed) == sorted([*ODD_NAMES, LAP, STOPPED])


def test_a_name_that_is_no_text_is_left_out(folder: Path) -> None:
    (folder / LAP).rename(folder / os.fsdecode(b"robot\xff"))
    with catalogue_of(folder) as catalogue:
        assert catalogue.left_out == ("robot\\udcff is left out: its name is no UTF-8",)
    with pytest.raises(Refused, match="no UTF-8"), catalogue_of(Path(os.fsdecode(b"\xff"))):
        pass


def test_a_recording_that_is_removed_meanwhile_is_left_out(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    index_path(folder / LAP).unlink()

    def remove(recordings: list[Path], *_: object) -> dict[Path, str]:
        shutil.rmtree(folder / LAP)
        return {}

    monkeypatch.setattr(catalogues, "index_recordings", remove)
    with catalogue_of(folder) as catalogue:
        assert f"{LAP} is left out: it was removed meanwhile" in catalogue.left_out
        shutil.rmtree(folder / STOPPED)
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
    assert recordings_found(folder) == [LAP, STOPPED]  # what is needed is imported
    with descriptors(3), pytest.raises(OSError, match="Too many open files"), catalogue_of(folder):
        pass
    assert recordings_found(folder) == [LAP, STOPPED]


def kill_while_it_indexes(recording: Path, after_s: float) -> None:
    """Start to index a recording, kill the process, and expect a valid index or none."""
    index_path(recording).unlink(missing_ok=True)
    child = start(job_command(INDEX, {"recording": str(recording)}))
    child.wait(after_s)
    child.kill(signal.SIGKILL)
    child.close()
    left = {recording.name: stamp_of(files_of(recording))} if index_path(recording).exists() else {}
    assert stamps_in(index_path(recording)) == left
    derived = {each.name for each in derived_files(recording)}
    assert {each.name for each in recording.iterdir()} - derived == {
        "metadata.yaml",
        *map(os.path.basename, files_of(recording)),
    }


def test_a_kill_leaves_a_valid_index_or_none(folder: Path) -> None:
    for after_s in (0.1, 0.3):
        kill_while_it_indexes(folder / LAP, after_s)


@pytest.mark.slow
def test_a_kill_at_any_moment_leaves_a_valid_index_or_none(folder: Path) -> None:
    for number in range(100):
        kill_while_it_indexes(folder / LAP, 0.01 * number)


def test_what_a_kill_left_is_removed_later(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    left = folder / LAP / f".{CATALOGUE_NAME}.123.tmp"
    left.write_bytes(b"PAR1")
    assert left in derived_files(folder / LAP)
    assert index_recording(folder / LAP) == ""
    assert left.exists()  # its process may be at work
    monkeypatch.setattr(files, "ABANDONED_S", -1.0)
    assert index_recording(folder / LAP) == ""
    assert not left.exists()


def test_a_full_disk_is_told_in_the_words_of_the_system(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = SimpleNamespace(f_bavail=0)
    monkeypatch.setattr(os, "fstatvfs", lambda descriptor: full)
    with pytest.raises(OSError, match="No space left on device"):
        databases.write_parquet(tmp_path / "index.parquet", "SELECT * FROM what_is_cut_short", [])
