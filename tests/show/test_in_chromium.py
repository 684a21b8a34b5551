"""The page of a recording in a real browser: no complaint, no request, and its links work."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path

import pytest
from PIL import Image

from robotctl.kernel.modes import Mode
from robotctl.kernel.types import ModeRequested
from robotctl.show.page import CommandVerdict, ReportFindings, Tone, report_page
from robotctl.show.traces import read_recorded
from robotctl.testing.drives import BEGIN_NS, drive, drive_requested, record
from tests.support.chromium import CHROMIUM, Chromium

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed"),
]

HOSTILE = "</script><script>document.title='taken'</script><img src=x onerror=\"alert(1)\">"


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chromium]:
    browser = Chromium(tmp_path_factory.mktemp("profile"))
    yield browser
    browser.close()


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of a drive that ends by a request, with hostile text."""
    folder = tmp_path_factory.mktemp("page")
    ended = ModeRequested(BEGIN_NS + 2_000_000_000, 3, Mode.IDLE.value, HOSTILE)
    written = drive(3.0, requests=[drive_requested(laps=1), ended])
    recorded = read_recorded(record(folder / "robot_20260101_120000", written))
    verdict = CommandVerdict("replay --check", "same", Tone.GOOD, (HOSTILE,))
    path = folder / "report.html"
    path.write_text(report_page(recorded, ReportFindings((verdict,))))
    return path


@pytest.fixture(autouse=True)
def without_complaint(browser: Chromium) -> Iterator[None]:
    browser.complaints.clear()
    browser.requested.clear()
    yield
    assert browser.complaints == []
    assert {url.split(":")[0] for url in browser.requested} <= {"about", "file"}


def cursor(browser: Chromium) -> float:
    """Return the time to which the cursor points [s]."""
    return float(browser.value("document.querySelector('#pointer input').value"))


def test_the_page_opens_without_a_complaint_and_asks_for_nothing(
    browser: Chromium, page: Path
) -> None:
    browser.open(page.as_uri())
    assert browser.requested == [page.as_uri()]
    assert browser.value("document.title") == "robot_20260101_120000: robotctl report"
    assert browser.value("document.scripts.length") == 2
    assert browser.value("document.images.length") == 0


def test_a_click_on_a_moment_moves_the_cursor_in_every_plot(browser: Chromium, page: Path) -> None:
    browser.open(page.as_uri())
    assert browser.value("document.querySelectorAll('.pointed').length") == 0
    links = "[...document.querySelectorAll('#moments a[data-t]')]"
    times = browser.value(f"{links}.map(each => Number(each.dataset.t))")
    assert times
    for number, t_s in enumerate(times):
        browser.value(f"{links}[{number}].click()")
        assert cursor(browser) == pytest.approx(t_s)
        assert browser.value("location.hash") == f"#moment-{number + 1}"
        assert (
            browser.value("document.querySelector('.moment.chosen').id") == f"moment-{number + 1}"
        )
    moved = (
        "[...document.querySelectorAll('svg.time .cursor')].map(e => e.getAttribute('transform'))"
    )
    assert len(set(browser.value(moved))) == 1
    told = browser.value("document.querySelector('#plot-1').closest('figure').innerText")
    assert "command" in told
    assert browser.value(
        "Number(document.querySelector('svg.path circle.cursor').attributes.cx.value)"
    )


def test_a_link_to_a_moment_opens_the_page_there(browser: Chromium, page: Path) -> None:
    browser.open(f"{page.as_uri()}#moment-1")
    expected = browser.value("Number(document.querySelector('#moment-1').dataset.t)")
    assert cursor(browser) == pytest.approx(expected)
    browser.open("about:blank")
    browser.open(f"{page.as_uri()}#t=1.25")
    assert cursor(browser) == pytest.approx(1.25)


def test_every_inner_link_leads_somewhere(browser: Chromium, page: Path) -> None:
    browser.open(page.as_uri())
    lost = "[...document.links].filter(a => !document.querySelector(a.hash)).map(a => a.href)"
    assert browser.value(lost) == []


def test_no_part_is_wider_than_a_phone_or_a_screen(browser: Chromium, page: Path) -> None:
    browser.open(page.as_uri())
    for width in (360, 800, 1600):
        browser.screenshot(width, 900)
        assert browser.value("document.documentElement.scrollWidth") <= width


def test_the_page_is_light_or_dark_as_the_reader_wishes(browser: Chromium, page: Path) -> None:
    browser.open(page.as_uri())
    corners: list[tuple[object, ...]] = []
    for dark in (False, True):
        browser.dark(dark)
        with Image.open(io.BytesIO(browser.screenshot(1000, 800))) as image:
            corners.append(image.convert("L").crop((0, 0, 4, 4)).getextrema())
            assert len(image.convert("RGB").getcolors(1 << 20) or ()) > 50
    assert corners[0] == (255, 255)
    assert corners[1] < (40, 40)


def test_the_page_can_be_printed(browser: Chromium, page: Path) -> None:
    browser.open(page.as_uri())
    assert browser.pdf().startswith(b"%PDF")


def test_without_its_script_the_page_is_as_complete(browser: Chromium, page: Path) -> None:
    browser.open(page.as_uri())
    with_script = browser.value("document.querySelectorAll('svg, tr, dd, h2').length")
    browser.call("Emulation.setScriptExecutionDisabled", value=True)
    browser.open(f"{page.as_uri()}?")
    count = browser.value("document.querySelectorAll('svg, tr, dd, h2').length")
    pointers = browser.value("document.querySelectorAll('#pointer').length")
    browser.call("Emulation.setScriptExecutionDisabled", value=False)
    assert count == with_script
    assert pointers == 0
