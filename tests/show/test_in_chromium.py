"""The page of a recording in a real browser: no complaint, no request, and its links work."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import pytest

from robotctl.kernel.modes import Mode
from robotctl.kernel.types import ModeRequested
from robotctl.show.page import CommandVerdict, ReportFindings, Tone, report_page
from robotctl.show.traces import read_recorded
from robotctl.testing.drives import BEGIN_NS, drive, drive_requested, record

CHROMIUM: Final = shutil.which("chromium") or shutil.which("chromium-browser")
DEADLINE_S: Final = 60.0

FLAGS: Final = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
    *("--remote-debugging-pipe", "--hide-scrollbars"),
)


class Chromium:
    """A browser with one page. `complaints` are errors of the page, `requested` its requests."""

    def __init__(self, profile: Path) -> None:
        assert CHROMIUM is not None
        to_read, self._write = os.pipe()
        self._read, to_write = os.pipe()
        self.complaints: list[str] = []
        self.requested: list[str] = []
        self._session = ""
        self._number = 0
        self._pending = b""
        command = [CHROMIUM, *FLAGS, f"--user-data-dir={profile}", "about:blank"]

        def take_pipes() -> None:  # DevTools reads from 3 and writes to 4
            os.dup2(to_read, 13)
            os.dup2(to_write, 14)
            os.dup2(13, 3)
            os.dup2(14, 4)

        self._process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            preexec_fn=take_pipes,
            close_fds=False,
        )
        os.close(to_read)
        os.close(to_write)
        os.set_blocking(self._read, False)
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def close(self) -> None:
        """End the browser."""
        os.close(self._write)
        os.close(self._read)
        self._process.terminate()
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Call a method of the protocol, and return its result."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._number:
                assert "error" not in answer, answer
                result: dict[str, Any] = answer["result"]
                return result
            self._note(answer)

    def open(self, url: str) -> None:
        """Load a page, and wait until it is complete."""
        self.call("Page.navigate", url="about:blank")
        self.call("Page.navigate", url=url)
        until = time.monotonic() + DEADLINE_S
        while self.value("document.readyState") != "complete" or self.value("location.href") != url:
            assert time.monotonic() < until, "the page does not load"

    def value(self, expression: str) -> Any:
        """Return the value of an expression in the page."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def _next(self) -> dict[str, Any]:
        until = time.monotonic() + DEADLINE_S
        while b"\0" not in self._pending:
            assert time.monotonic() < until, "the browser does not answer"
            assert self._process.poll() is None, "the browser has ended"
            try:
                self._pending += os.read(self._read, 1 << 20)
            except BlockingIOError:
                time.sleep(0.005)
        message, _, self._pending = self._pending.partition(b"\0")
        decoded: dict[str, Any] = json.loads(message)
        return decoded

    def _note(self, event: dict[str, Any]) -> None:
        params = event.get("params", {})
        match event.get("method"):
            case "Runtime.exceptionThrown" | "Log.entryAdded" | "Runtime.consoleAPICalled":
                self.complaints.append(json.dumps(params)[:500])
            case "Network.requestWillBeSent":
                self.requested.append(params["request"]["url"])
            case _:
                pass


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


def test_the_page_opens_without_complaint_and_asks_nothing(browser: Chromium, page: Path) -> None:
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
