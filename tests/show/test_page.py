"""The page of a recording needs no network, shows every figure, and takes no markup from it."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from math import cos, inf, nan, sin
from pathlib import Path
from typing import Any

import pytest

from robotctl.kernel.modes import Mode
from robotctl.kernel.types import DriveReport, Event, ModeRequested
from robotctl.show.figure import Path2D, path_figure
from robotctl.show.page import CommandVerdict, Explanation, ReportFindings, Tone, report_page
from robotctl.show.png import write_path_png
from robotctl.show.terminal import ground_lines
from robotctl.show.traces import EndedDrive, Recorded, Traces, figures_of, read_recorded
from robotctl.testing.drives import BEGIN_NS, START_NS, Written, drive, drive_requested, record
from tests.support.bags import in_order, odometry, talk, write_bag
from tests.support.edited_recordings import Contents, recorded, write_contents
from tests.support.html_page import HtmlPage
from tests.support.recordings import Tape

GOLDEN = Path(__file__).parents[1] / "golden"
HOSTILE = "<script>alert(1)</script>\"'&<img src=x onerror=alert(1)>\x1b[2J\u202e]]>-->"
LIMIT_BYTES = 1_000_000
SECTIONS = {
    *("path", "time", "moments", "why", "drives", "modes", "verdicts"),
    *("messages", "provenance", "parameters"),
}
JUDGED = ReportFindings(
    (CommandVerdict("replay --check", "same", Tone.GOOD, ("compared bit for bit",)),),
    (Explanation(1.0, "MOVING -> IDLE: stopped", (("known", "battery 80 %"),)),),
)


@pytest.fixture(scope="module")
def written() -> list[Written]:
    """A drive of a second, then a request to stand, and its refusal of nonsense."""
    requests: list[Event] = [
        drive_requested(laps=1),
        ModeRequested(BEGIN_NS + 1_000_000_000, 2, 77, "operator"),
        ModeRequested(BEGIN_NS + 1_200_000_000, 3, Mode.IDLE.value, "operator"),
    ]
    return drive(2.5, requests=requests)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, written: list[Written]) -> Path:
    return record(tmp_path_factory.mktemp("report") / "robot_20260101_120000", written)


def page_of(path: Path, judged: ReportFindings = JUDGED) -> tuple[str, HtmlPage]:
    text = report_page(read_recorded(path), judged)
    return text, HtmlPage(text)


def assert_harmless(text: str, page: HtmlPage) -> None:
    assert page.wrong == []
    assert page.tags["script"] == 2
    assert not page.tags.keys() & {"img", "iframe", "object", "embed", "link", "base", "form"}
    assert [name for name in page.attributes if name.startswith("on")] == []
    assert "http" not in text.replace("http-equiv", "")
    assert not re.search(r"[\x00-\x08\x0b-\x1f\u202e]", text)
    assert len(text.encode()) <= LIMIT_BYTES


def test_the_page_of_a_drive_has_every_part_and_refers_to_nothing(folder: Path) -> None:
    text, page = page_of(folder)
    assert_harmless(text, page)
    assert page.ids.keys() >= SECTIONS
    assert page.ids.keys() >= {"plot-path", "plot-modes", *(f"plot-{n}" for n in range(1, 6))}


def test_every_figure_is_on_the_page_with_its_value(folder: Path) -> None:
    text, page = page_of(folder)
    for figure in figures_of(read_recorded(folder)):
        assert f"figure-{figure.key}" in page.ids
        assert f"<dt>{figure.name}</dt><dd>{figure.text}</dd>" in text


def test_the_figures_are_those_of_the_drive(folder: Path, written: list[Written]) -> None:
    found = read_recorded(folder)
    (ended,) = found.traces.drives
    figures = {figure.key: figure.value for figure in figures_of(found)}
    assert figures["drives"] == 1
    assert figures["distance_m"] == ended.report.distance_m
    assert figures["cross_track_max_m"] == ended.report.cross_track_max_m
    assert figures["cross_track_rms_m"] == pytest.approx(ended.report.cross_track_rms_m)
    assert figures["lost"] == 0
    assert [span.mode for span in found.traces.modes] == ["IDLE", "MOVING", "IDLE"]
    (wanted,) = found.traces.wanted
    assert wanted[0] == pytest.approx(wanted[-1], abs=1e-9)  # a square is closed
    assert max(x for x, _ in wanted) == pytest.approx(1.0, abs=0.01)


def test_the_policy_of_the_page_allows_its_own_script_and_no_other(folder: Path) -> None:
    text, _ = page_of(folder)
    policy = re.search(r'Content-Security-Policy" content="([^"]+)"', text)
    assert policy is not None
    assert policy[1].startswith("default-src 'none'; style-src 'sha256-")
    assert "unsafe" not in policy[1]


def hostile(contents: Contents, texts: int) -> Contents:
    """Return a recording with hostile text wherever a recording may hold text."""
    contents = contents.copy()
    channel, schema = contents.types[0]
    for number in range(texts):
        topic = f"/{number}{HOSTILE}"
        contents.types.append((replace(channel, topic=topic), replace(schema, name=HOSTILE)))
        values = {"kind": "mark", "log_ns": str(START_NS + number), "text": HOSTILE * 20}
        contents.metadata.append(("robotctl.event", values))
    _, values = next(each for each in contents.metadata if each[0] == "robotctl")
    values |= {f"{HOSTILE}{number}": HOSTILE * 20 for number in range(texts)}
    values |= {f"parameter.{HOSTILE}{number}": HOSTILE * 20 for number in range(texts)}
    return contents


@pytest.mark.parametrize("texts", [1, 400])
def test_text_of_a_recording_never_becomes_markup_nor_too_long_a_page(
    tmp_path: Path, written: list[Written], texts: int
) -> None:
    made = write_contents(tmp_path / "h", hostile(recorded(written), texts))
    judged = ReportFindings(
        (CommandVerdict(HOSTILE, HOSTILE, Tone.BAD, (HOSTILE,)),),
        (Explanation(1.0, HOSTILE, ((HOSTILE, HOSTILE),)),),
    )
    text, page = page_of(made, judged)
    assert_harmless(text, page)
    for part in ("moments", "why", "verdicts", "messages", "provenance", "parameters"):
        assert "<script>alert(1)</script>" in page.sections[part]  # as text


def test_the_fullest_page_keeps_its_limit(folder: Path) -> None:
    worst = '"' * 1000
    info = read_recorded(folder).info
    traces = Traces(1000.0)
    for n in range(5_000):
        t_s = n / 5
        traces.enter_mode(t_s, ("IDLE", "MOVING")[n % 2], worst)
        traces.happened(t_s, "mark", worst)
        traces.drive_ended(EndedDrive(t_s, worst, DriveReport(1, 1e9, 1e9, 1e9, 1e9)))
        traces.want([(n * 1.23456, n * 7.654321)] * 500)
        traces.driven.add(t_s, 1234.5678 * sin(n), 1234.5678 * cos(n))
        for series in traces.series():
            series.add(t_s, -123.45678 * sin(n * 1.7))
    topics = [replace(info.topics[0], name=f"{worst}{n}", type_name=worst) for n in range(1000)]
    told = {f"{n}{worst}": worst for n in range(1000)}
    told |= {f"parameter.{key}": value for key, value in told.items()}
    info = replace(info, topics=tuple(topics), metadata={"robotctl": told})
    for topic in topics:
        for n in range(60):
            traces.rates.add(topic.name, n * 1000 / 60)
    full = Recorded(info, traces, True, (), (worst,) * 20, True, True)
    judgement = CommandVerdict(worst, worst, Tone.BAD, (worst,) * 20)
    why = Explanation(1.0, worst, ((worst, worst),) * 6)
    judged = ReportFindings((judgement, judgement), (why,) * 5)
    text = report_page(full, judged)
    assert_harmless(text, HtmlPage(text))
    assert "more modes, moments, drives or wanted paths are not shown" in text
    assert re.search(r"and [5-9]\d\d more", text)


def test_the_name_of_a_recording_is_text_too(tmp_path: Path, folder: Path) -> None:
    named = tmp_path / "<b>robot & 'x'"
    named.symlink_to(folder)
    renamed = tmp_path / "a<script>b.mcap"
    renamed.write_bytes(next(folder.glob("*.mcap")).read_bytes())
    assert_harmless(*page_of(renamed))


@pytest.mark.parametrize("name", ["stopped", "killed", "foreign"])
def test_recordings_of_the_first_version_are_shown(name: str) -> None:
    text, page = page_of(GOLDEN / name)
    assert_harmless(text, page)
    assert ("was never closed" in text) == (name == "killed")


def test_a_bag_of_another_recorder_is_shown_as_far_as_it_goes(tmp_path: Path) -> None:
    lines = in_order([odometry(20.0 * n, n / 100) for n in range(50)], talk("/chat", 40))
    bag = write_bag(tmp_path / "bag.mcap", lines)
    text, page = page_of(bag, ReportFindings())
    assert_harmless(text, page)
    assert "There is no journal of robotctl in it. Drawn: /odom." in text
    assert page.ids.keys() >= {"path", "plot-1", "messages"}
    assert not page.ids.keys() & {"modes", "drives", "why", "verdicts"}
    assert "/chat" in page.sections["messages"]


def test_a_bag_without_anything_to_draw_is_a_page_too(tmp_path: Path) -> None:
    text, page = page_of(write_bag(tmp_path / "bag.mcap", talk("/chat", 1)), ReportFindings())
    assert_harmless(text, page)
    assert "no topic that can be drawn" in text
    empty = write_bag(tmp_path / "empty.mcap", [])
    assert_harmless(*page_of(empty, ReportFindings()))


def test_odometry_that_is_no_number_is_counted_and_not_drawn(tmp_path: Path) -> None:
    places = [0.0, float("nan"), float("inf"), 1e300, 0.5]
    bag = write_bag(tmp_path / "bag.mcap", [odometry(10.0 * n, x) for n, x in enumerate(places)])
    text, page = page_of(bag, ReportFindings())
    assert_harmless(text, page)
    assert len(read_recorded(bag).traces.driven.whole()) == 2
    assert "nan" not in text.lower().replace("provenance", "")


def test_a_state_of_no_kernel_is_told_and_not_drawn(tmp_path: Path, written: list[Written]) -> None:
    contents = recorded(written)
    for number, message in enumerate(contents.messages):
        if message.topic.endswith("journal") and b'"size_m":1.0' in message.data:
            changed = message.data.replace(b'"size_m":1.0', b'"size_m":0.0')
            contents.messages[number] = replace(message, data=changed)
    text, page = page_of(write_contents(tmp_path / "h", contents))
    assert_harmless(text, page)
    assert "Not read:" in text


def test_figures_of_impossible_drives_are_not_known(folder: Path) -> None:
    found = read_recorded(folder)
    for distance_m, error_m in ((nan, 1e308), (inf, -inf), (1e308, nan)):
        report = DriveReport(1, distance_m, error_m, error_m, nan, duration_s=1e308)
        found.traces.drives[:] = [EndedDrive(1.0, "odd", report)] * 2
        figures = {figure.key: figure.value for figure in figures_of(found)}
        assert figures["distance_m"] is None
        assert figures["cross_track_rms_m"] is None
        text = report_page(found, JUDGED)
        assert_harmless(text, HtmlPage(text))


def test_a_recording_under_way_is_shown_as_far_as_it_is_committed(tmp_path: Path) -> None:
    recorder = Tape(tmp_path / "run")
    recorder.commands(range(1, 11))
    recorder.settle()
    text, page = page_of(tmp_path / "run", ReportFindings())
    recorder.close()
    assert_harmless(text, page)
    assert "This recording is being written" in text
    assert "This recording is being written" not in page_of(tmp_path / "run", ReportFindings())[0]


SQUARE: Path2D = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.0, 0.0)]
NAN = float("nan")


def braille(
    reference: Path2D, driven: Path2D, *, rows: int = 18, colour: bool = False
) -> list[str]:
    return ground_lines(path_figure(reference, driven), rows=rows, colour=colour)


def write_png(file: Path, reference: Path2D, driven: Path2D, title: str) -> None:
    write_path_png(file, path_figure(reference, driven, title))


def dots(lines: list[str]) -> int:
    """Return the number of braille dots."""
    return sum(
        (ord(c) - 0x2800).bit_count() for line in lines for c in line if "\u2800" <= c < "\u2900"
    )


def test_a_square_is_as_high_as_it_is_wide() -> None:
    *rows, axis, numbers = braille([], SQUARE, rows=10)
    assert rows[0].startswith("   1.00 \u2502")
    assert rows[-1].startswith("   0.00 \u2502")
    assert " ".join(numbers.split()) == "0.00 1.00 m a dot is 26 mm"
    columns = axis.count("\u2500")
    assert columns * 2 == len(rows) * 4  # dots


def test_the_driven_path_lies_over_the_wanted_one() -> None:
    away = [(2.0, 0.0), (2.0, 1.0)]
    wanted, driven, both = (
        dots(braille(*paths)) for paths in ((SQUARE, away), (away, SQUARE), (SQUARE, SQUARE))
    )
    assert wanted < driven  # the wanted path is dotted
    assert both == dots(braille([], SQUARE))


@pytest.mark.parametrize(
    "path",
    [
        [],
        [(0.0, 0.0)],
        [(1.0, 2.0)] * 5,
        [(0.0, 0.0), (1000.0, 0.0)],
        [(0.0, 0.0), (0.0, 1e-9)],
        [(0.0, 0.0), (NAN, 1.0), (1.0, math.inf), (1.0, 1.0)],
    ],
)
def test_every_path_can_be_drawn(path: Path2D, tmp_path: Path) -> None:
    lines = braille(path, path)
    assert all(len(line) <= 80 for line in lines)
    assert dots(lines) > 0 or not path
    write_png(tmp_path / "path.png", path, path, "any")
    assert (tmp_path / "path.png").stat().st_size > 1000


def test_colour_tells_the_paths_apart_and_changes_nothing_else() -> None:
    coloured = "\n".join(braille(SQUARE, [(0.5, 0.5), (0.6, 0.6)], colour=True))
    plain = "\n".join(braille(SQUARE, [(0.5, 0.5), (0.6, 0.6)]))
    assert "\x1b[32m" in coloured
    assert "\x1b[34m" in coloured
    for code in ("\x1b[32m", "\x1b[34m", "\x1b[0m"):
        coloured = coloured.replace(code, "")
    assert coloured == plain


def test_the_png_is_a_square_with_both_paths_in_it(tmp_path: Path) -> None:
    from PIL import Image

    write_png(tmp_path / "path.png", SQUARE, [(0.5, 0.0), (0.5, 1.0)], "a title")
    with Image.open(tmp_path / "path.png") as image:
        assert image.size == (800, 800)
        pixels: Any = image.load()
        red, green, blue = pixels[400, 400]
        edge, corner = pixels[400, 103], pixels[5, 5]
    assert (red > 200, green < 100, blue < 60) == (True, True, True)
    assert edge != corner == (255, 255, 255)
