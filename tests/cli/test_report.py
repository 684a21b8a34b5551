"""`report` writes one page beside the recording, and says what is in it."""

from __future__ import annotations

from pathlib import Path

import pytest

from robotctl.testing.drives import drive, record
from tests.cli.conftest import Cli
from tests.support.html_page import HtmlPage


@pytest.fixture
def folder() -> Path:
    return record(Path("recordings/robot_20260101_120000"), drive(1.0))


def test_the_page_is_written_beside_the_recording(folder: Path, cli: Cli) -> None:
    cli("report", "last").succeeded(f"{folder}/report.html", "replay --check: same, verify: whole")
    page = HtmlPage((folder / "report.html").read_text())
    assert page.wrong == []
    assert "same" in page.sections["verdicts"]
    assert cli("report", "last").exit_code == 0  # again: the page is replaced
    assert cli("replay", "last", "--check").exit_code == 0
    assert cli("verify", "last").exit_code == 4  # whole, not sealed: as before


def test_json_tells_what_was_written(folder: Path, cli: Cli) -> None:
    answer = cli("report", "last", "-o", "page.html", "--json").summary
    assert answer["report"] == "page.html"
    assert answer["bytes"] == Path("page.html").stat().st_size
    (about,) = answer["recordings"]
    assert about["verdicts"] == {"replay --check": "same", "verify": "whole"}
    assert about["figures"]["messages"] > 100
    assert about["missing"] == []


def test_the_help_promises_no_page_of_a_url(cli: Cli) -> None:
    assert "URL" not in cli("report", "--help").out


def test_a_damaged_recording_is_shown_as_far_as_it_can_be_read(folder: Path, cli: Cli) -> None:
    (file,) = folder.glob("*.mcap")
    data = file.read_bytes()
    Path("cut.mcap").write_bytes(data[: len(data) // 2])
    cli("report", "cut.mcap").failed(6, "robotctl recover")
    assert "Not read:" in Path("cut.report.html").read_text()


def test_a_page_that_cannot_be_written_is_refused_with_the_reason(folder: Path, cli: Cli) -> None:
    target = Path("elsewhere.html")
    target.symlink_to(folder / "metadata.yaml")
    before = (folder / "metadata.yaml").read_text()
    Path("folder.html").mkdir()
    for name in ("elsewhere.html", "no/such/folder.html", "folder.html"):
        cli("report", "last", "-o", name).failed(4, f"cannot write {name}", "-o FILE")
    assert (folder / "metadata.yaml").read_text() == before
    (file,) = folder.glob("*.mcap")
    data = file.read_bytes()
    cli("report", "last", "-o", str(file)).failed(2, "ends in .html")
    assert file.read_bytes() == data, "a recording is never replaced by its page"
