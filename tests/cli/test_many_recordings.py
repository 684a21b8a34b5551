"""`robotctl find` and `index`, as a user types them; recordings are indexed in processes."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest

from robotctl.cli.ui import text
from robotctl.collection.indexing import index_recording
from robotctl.testing.drives import drive, record
from tests.cli.conftest import Cli

pytest.importorskip("duckdb", reason="indexes are an extra: robotctl[parquet]")
LAP = Path("recordings/robot_20260101_120000")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made") / "recordings"
    assert index_recording(record(folder / LAP.name, drive(4.0))) == ""
    return folder


@pytest.fixture
def indexed(made: Path, cli: Cli) -> None:
    """A recording in ./recordings that has an index."""
    shutil.copytree(made, LAP.parent)


def test_a_user_finds_the_drives_of_a_folder(cli: Cli) -> None:
    record(LAP, drive(2.0))
    out = cli("find", "drive >= 1").succeeded(LAP.name)
    assert out.endswith("1 row\n")
    found = cli("find", "--recordings", "--json").summary
    assert found["left_out"] == []
    assert found["rows"][0]["recording"] == LAP.name
    indexed = cli("index", "--json").summary
    assert indexed["indexed"] == 1
    counted = cli("find", "--sql", "SELECT count(*) AS drives FROM drives").out
    assert counted.split() == ["drives", "1", "1", "row"]


@pytest.mark.usefixtures("indexed")
@pytest.mark.parametrize(
    "command", [("index",), ("find", "--in"), ("find", "--sql", "SELECT 1", "--in")]
)
def test_without_the_extra_a_question_is_one_sentence_with_its_cure(
    cli: Cli, monkeypatch: pytest.MonkeyPatch, command: tuple[str, ...]
) -> None:
    monkeypatch.setitem(sys.modules, "duckdb", None)
    err = cli(*command, "recordings").refused(2)
    said = "an index needs duckdb, which is not installed: pip install 'robotctl[parquet]'"
    assert err.split("robotctl: ")[1:] == [f"{said}\n"]


@pytest.mark.usefixtures("indexed")
def test_a_row_of_an_answer_opens_at_its_moment(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    out = cli("find", "--open", "1").succeeded()
    assert out.startswith(f"{LAP}/report.html ")
    (event,) = cli("find", "mode == 'MOVING'", "--events", "--json").summary["rows"]
    clip = cli("find", "--events", "--open", "1", "--as", "clip", "--json").summary
    assert abs(clip["event_ns"] - event["start_ns"]) < 1_000_000
    assert Path(clip["target"]).parent == LAP.absolute() / "clips"
    query = "SELECT recording, start_ns + 1000000000 AS start_ns FROM drives"
    later = cli("find", "--sql", query, "--open", "1", "--as", "clip", "--json")
    assert abs(later.summary["event_ns"] - event["start_ns"] - 1_000_000_000) < 1_000_000


@pytest.mark.usefixtures("indexed")
@pytest.mark.parametrize(
    ("arguments", "exit_code", "says"),
    [
        (("--open", "2"), 4, "there is no row 2: the answer has 1"),
        (("laps > 9", "--open", "1"), 4, "there is no row 1: the answer has none"),
        (("--recordings", "--open", "1", "--as", "clip"), 2, "no moment to clip"),
        (("--sql", "SELECT 1 AS a", "--open", "1"), 2, "needs the column recording"),
    ],
)
def test_a_row_that_cannot_be_opened_is_named(
    cli: Cli, arguments: tuple[str, ...], exit_code: int, says: str
) -> None:
    cli("find", *arguments).failed(exit_code, says)


@pytest.mark.usefixtures("indexed")
def test_an_answer_fits_a_terminal_of_80_columns_and_is_whole_in_a_pipe(
    cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    long = LAP.rename(LAP.with_name("robot_20260101_120000_with_a_long_name"))
    for table in ((), ("--recordings",), ("--events",), ("--topics",)):
        piped = cli("find", *table).out
        with monkeypatch.context() as terminal:
            terminal.setattr(text, "_terminal_columns", lambda: 80)
            shown = cli("find", *table).out
        assert max(map(len, shown.splitlines())) <= 80
        assert long.name in piped
        assert f"{long.name[:12]}..{long.name[-12:]}" in shown
        assert len(shown.splitlines()) >= len(piped.splitlines())


@pytest.mark.usefixtures("indexed")
def test_a_browser_shows_the_page_at_the_moment_where_there_is_a_display(
    cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    for display in (":0", ""):
        monkeypatch.setenv("DISPLAY", display)
        monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
        assert cli("find", "--open", "1").exit_code == 0
    (url,) = opened
    assert url.startswith(f"file://{LAP.absolute()}/report.html#t=")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--recordings", "--events"), "two tables"),
        (("laps > 1", "--sql", "SELECT 1"), "a whole question"),
        (("--in", "nowhere"), "no such folder"),
    ],
)
def test_options_that_contradict_each_other_are_named(
    cli: Cli, arguments: tuple[str, ...], says: str
) -> None:
    cli("find", *arguments).failed(2, says)
