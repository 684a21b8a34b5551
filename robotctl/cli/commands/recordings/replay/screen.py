"""The screen of a replay: notes and a bar, the robot with --draw, and the summary."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Protocol

from robotctl.cli.ui.text import duration, is_terminal, printable
from robotctl.kernel.units import NS_PER_S

if TYPE_CHECKING:
    from rich.console import RenderableType

    from robotctl.replay.recorded_robot import RecordedRobot


KEYS = "space pause   n next message   + - rate   q quit"
_BAR_WIDTH = 78
LINE_S = 1.0
"""The period of the lines that --draw prints without a terminal."""


class Screen(Protocol):
    """Shows a replay to the user, from the reports of the player process."""

    def show(self, report: dict[str, Any]) -> None:
        """Show a report: a note, the wait for subscribers, the start, or the progress."""

    def suspend(self) -> None:
        """Stop drawing while other programs use the terminal."""

    def resume(self) -> None:
        """Draw again."""


@contextmanager
def screen(robot: RecordedRobot | None, *, quiet: bool) -> Iterator[Screen]:
    """Yield a screen: a bar on a terminal, otherwise printed notes; `quiet` shows nothing."""
    if quiet:
        yield _Nothing()
    elif is_terminal():
        bar = _Bar(robot)
        bar.resume()
        try:
            yield bar
        finally:
            bar.suspend()
    else:
        yield _Notes(robot)


class _Nothing:
    def show(self, report: dict[str, Any]) -> None:
        pass

    def suspend(self) -> None:
        pass

    def resume(self) -> None:
        pass


class _Notes(_Nothing):
    """A screen that prints notes and, with a recorded robot, one line per second."""

    def __init__(self, robot: RecordedRobot | None) -> None:
        self._robot = robot
        self._line_at = 0.0

    def show(self, report: dict[str, Any]) -> None:
        if "note" in report:
            print(printable(report["note"]), flush=True)
        if "progress" in report and self._robot is not None:
            self._print_robot(self._robot, report["progress"]["position_s"])

    def _print_robot(self, robot: RecordedRobot, position_s: float) -> None:
        from robotctl.cli.ui.panels import recorded_line

        robot.advance(round(position_s * NS_PER_S))
        if time.monotonic() >= self._line_at:
            self._line_at = time.monotonic() + LINE_S
            print(f"{position_s:.1f} s  {recorded_line(robot)}", flush=True)


class _Bar:
    """A screen with a bar that updates in place, below the notes."""

    def __init__(self, robot: RecordedRobot | None) -> None:
        from rich.live import Live

        # Nothing else prints meanwhile, and a redirected stdout would hide its encoding.
        self._live = Live(
            auto_refresh=False, transient=True, redirect_stdout=False, redirect_stderr=False
        )
        self._robot = robot
        self._length_s = 0.0

    def show(self, report: dict[str, Any]) -> None:
        if "note" in report:
            self._live.console.print(printable(report["note"]), markup=False, highlight=False)
        elif "waiting" in report:
            there, expected = report["waiting"]["there"], report["waiting"]["for"]
            self._draw(f"waiting for subscribers: {there} of {expected}")
        elif "start" in report:
            self._length_s = report["start"]["length_s"]
        elif "progress" in report:
            self._draw(self._bar(report["progress"]), report["progress"]["position_s"])

    def suspend(self) -> None:
        self._live.stop()

    def resume(self) -> None:
        self._live.start()

    def _draw(self, line: RenderableType, position_s: float = 0.0) -> None:
        from rich.console import Group

        parts = [line]
        if self._robot is not None:
            from robotctl.cli.ui.panels import recorded_view

            self._robot.advance(round(position_s * NS_PER_S))
            parts.insert(0, recorded_view(self._robot))
        self._live.update(Group(*parts), refresh=True)

    def _bar(self, progress: dict[str, Any]) -> RenderableType:
        from rich.progress_bar import ProgressBar
        from rich.table import Table
        from rich.text import Text

        position_s, length_s = progress["position_s"], self._length_s
        if length_s and position_s > length_s:  # with --loop: the sum of all rounds
            position_s %= length_s
        lines = Table.grid()
        lines.add_row(ProgressBar(total=length_s or 1.0, completed=position_s, width=_BAR_WIDTH))
        lines.add_row(Text(bar_text(progress, position_s, length_s)))
        lines.add_row(Text(KEYS, style="dim"))
        return lines


def bar_text(progress: dict[str, Any], position_s: float, length_s: float) -> str:
    """Return position, rate, pause and delay of a replay as one line."""
    rate = progress["rate"]
    parts = [
        f"{position_s:.1f} of {duration(length_s)}",
        "as fast as possible" if rate is None else f"x{rate:g}",
    ]
    if "sent" in progress:
        parts.append(f"{progress['sent']} sent")
    if progress["paused"]:
        parts.append("paused")
    if progress.get("behind"):
        parts.append(f"{progress['behind']} behind schedule")
    return "   ".join(parts)


def summary_lines(summary: dict[str, Any]) -> Iterator[str]:
    """Yield the lines of a replay's summary; `summary` is its object in `--json`."""
    domain, names = summary["domain_id"], summary["prefix"]
    where = f"with the prefix {names}" if names else "under the original names"
    yield f"  sent        {summary['sent']} messages in ROS domain {domain}, {where}"
    if summary["failed"]:
        yield f"  not sent    {summary['failed']} messages, refused by the middleware"
    for topic, count in summary["withheld"].items():
        yield f"  withheld    {printable(topic)}, {count} messages"
    for topic, reason in summary["skipped"].items():
        yield f"  skipped     {printable(topic)}: {printable(reason)}"
    timing = summary["timing_error_us"]
    if timing is not None:
        p50, p99, worst = (_microseconds(timing[key]) for key in ("p50", "p99", "max"))
        yield f"  timing      {p50} late p50, {p99} p99, {worst} at most"


def _microseconds(value: float) -> str:
    return f"{value:.0f} us" if value < 10_000 else f"{value / 1000:.0f} ms"
