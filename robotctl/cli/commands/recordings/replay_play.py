"""Play a recording to ROS, or draw it in the terminal."""

from __future__ import annotations

import select
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from typing import TYPE_CHECKING, Any, Final

from robotctl.base.errors import Interrupted, RobotctlError, UsageError, error_for_exit_code
from robotctl.base.processes import Child, program, start
from robotctl.cli.ui.keys import Keyboard
from robotctl.cli.ui.output import print_answer
from robotctl.cli.ui.text import duration, is_terminal, printable
from robotctl.kernel.constants import NS_PER_S
from robotctl.replay.job import Job
from robotctl.replay.playback_control import Command, PlaybackControl, carry_out

if TYPE_CHECKING:
    from rich.console import RenderableType

    from robotctl.replay.recorded_robot import RecordedRobot
    from robotctl.replay.timeline import Span


KEYS = "space pause   n next message   + - rate   q quit"
_BAR_WIDTH = 78
LINE_S = 1.0
"""The period of the lines of --draw without a terminal [s]."""


class Screen:
    """Displays the reports of the player process; this base class shows nothing."""

    def show(self, report: dict[str, Any]) -> None:
        """Show a report of the player: a note, missing subscribers, the start, or the progress."""

    def suspend(self) -> None:
        """Stop drawing while other programs use the terminal."""

    def resume(self) -> None:
        """Draw again after `suspend`."""


@contextmanager
def screen(robot: RecordedRobot | None, *, quiet: bool) -> Iterator[Screen]:
    """Yield a screen that shows the progress and, if given, `robot`; `quiet` shows nothing."""
    if quiet:
        yield Screen()
    elif is_terminal():
        bar = _Bar(robot)
        bar.resume()
        try:
            yield bar
        finally:
            bar.suspend()
    else:
        yield _Notes(robot)


class _Notes(Screen):
    """A screen that prints notes and, with a recorded robot, one line per second."""

    def __init__(self, robot: RecordedRobot | None) -> None:
        self._robot = robot
        self._line_at = 0.0

    def show(self, report: dict[str, Any]) -> None:
        if "note" in report:
            print(printable(report["note"]), flush=True)
        if "progress" in report and self._robot is not None:
            from robotctl.cli.ui.panels import recorded_line

            position_s = report["progress"]["position_s"]
            self._robot.advance(round(position_s * NS_PER_S))
            if time.monotonic() >= self._line_at:
                self._line_at = time.monotonic() + LINE_S
                print(f"{position_s:.1f} s  {recorded_line(self._robot)}", flush=True)


class _Bar(Screen):
    """A screen with a bar below the notes."""

    def __init__(self, robot: RecordedRobot | None) -> None:
        from rich.live import Live

        # A redirected stdout hides its encoding, and nothing else prints while this is shown.
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
    """Return a line with position, rate, pause, and the numbers of sent and overdue messages."""
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


COMMAND_OF_KEY: Final = {
    " ": Command.TOGGLE,
    "+": Command.FASTER,
    "=": Command.FASTER,
    "-": Command.SLOWER,
    "n": Command.NEXT,
}
"""The command of each key except QUIT; `=` is the plus key without Shift."""

QUIT: Final = "q"


PLAYER: Final = "robotctl.replay"
"""The module of the player process."""

END_DEADLINE_S = 15.0
"""The timeout for the player to remove its publishers from the graph and exit [s]."""


def play_in_process(job: Job, open_screen: Callable[[], AbstractContextManager[Screen]]) -> _Player:
    """Play a recording in a child process, and return the ended player.

    The first Ctrl-C ends the replay. The screen opens while the process joins ROS.

    Raises:
        RobotctlError: The process ended without a summary or an error.
        KeyboardInterrupt: Ctrl-C was pressed a second time.
    """
    player = _Player(start(program(PLAYER), with_stdin=True))
    try:
        player.send(f"{job.to_json()}\n".encode())
        with open_screen() as player.screen, Keyboard(player.suspend, player.resume) as keyboard:
            while not player.ended:
                try:
                    player.wait_for_input(keyboard)
                except KeyboardInterrupt:
                    if player.interrupted:
                        raise
                    player.interrupted = True
                    player.child.close_stdin()
    finally:
        exit_code = player.child.close(END_DEADLINE_S)
    if not (player.summary or player.error or player.interrupted):
        raise RobotctlError(
            f"the player ended with exit code {exit_code} before the replay was over "
            "(see why with: robotctl --debug replay ...)"
        )
    return player


class _Player:
    """Handles the reports of the player process and the keys of the user."""

    def __init__(self, child: Child) -> None:
        self.child = child
        self.screen = Screen()
        self.summary: dict[str, Any] = {}
        self.error: RobotctlError | None = None
        self.interrupted = False
        """Whether Ctrl-C or a signal has ended the replay."""
        self.ended = False
        """Whether the process will report nothing more."""
        self._paused = False
        self._was_playing = False

    def wait_for_input(self, keyboard: Keyboard) -> None:
        """Wait for a report of the process or for a key, and handle it."""
        child = self.child
        patience_s = None if child.has_stdin else END_DEADLINE_S
        ready, _, _ = select.select([child.fileno(), *keyboard.sources], [], [], patience_s)
        self.ended = not ready
        if child.fileno() in ready:
            try:
                for report in child.receive():
                    self._handle(report)
            except EOFError:
                self.ended = True
        if not set(ready).isdisjoint(keyboard.sources):
            for key in keyboard.read():
                if key == QUIT:
                    child.close_stdin()
                elif key in COMMAND_OF_KEY:
                    self.send(COMMAND_OF_KEY[key].line())

    def suspend(self) -> None:
        """Pause the player before this process stops."""
        self._was_playing = not self._paused
        self.send(Command.PAUSE.line())
        self.screen.suspend()

    def resume(self) -> None:
        """Continue, unless the replay was paused before `suspend`."""
        self.screen.resume()
        if self._was_playing:
            self.send(Command.RESUME.line())

    def send(self, line: bytes) -> None:
        """Send a line to the player process, unless the process has ended."""
        with suppress(BrokenPipeError):
            self.child.send(line)

    def _handle(self, report: dict[str, Any]) -> None:
        if "error" in report:
            self.error = error_for_exit_code(report["exit_code"], report["error"], report)
        if "progress" in report:
            self._paused = report["progress"]["paused"]
        self.summary = report.get("summary", self.summary)
        self.screen.show(report)


def play_command(job: Job, *, draw: bool, as_json: bool) -> None:
    """Publish a recording to ROS, and print the summary; if `draw`, draw the robot, too.

    Raises:
        Interrupted: Ctrl-C or a signal ended the replay.
        RobotctlError: The player process failed.
    """

    @contextmanager
    def open_screen() -> Iterator[Screen]:
        with ExitStack() as stack:
            robot = None
            if draw:
                robot, _ = stack.enter_context(recorded_robot(job))
            yield stack.enter_context(screen(robot, quiet=as_json))

    player = play_in_process(job, open_screen)
    error = Interrupted() if player.interrupted else player.error
    if player.summary:
        lines = summary_lines(player.summary)
        print_answer(player.summary, lines, as_json=as_json, error=error)
    elif error is not None:
        raise error


PERIOD_S: Final = 0.1
"""The period in which the robot is drawn [s]."""


def draw_command(job: Job, *, quiet: bool) -> None:
    """Draw the recorded robot at the job's rate until the end of the time span or the quit key.

    Raises:
        UsageError: The rate is `max`, or the recording has nothing to draw.
    """
    if job.rate is None:
        raise UsageError("--draw-only cannot draw at --rate max", "give --rate a number")
    with recorded_robot(job) as (robot, span), screen(robot, quiet=quiet) as shown:
        viewer = _Viewer(job, robot, shown)
        shown.show({"start": {"length_s": span.length_ns / NS_PER_S}})
        with Keyboard(viewer.suspend, viewer.resume) as keyboard:
            while not viewer.quit and (job.loop or viewer.position_ns <= span.length_ns):
                shown.show({"progress": viewer.progress()})
                ready, _, _ = select.select(keyboard.sources, [], [], PERIOD_S)
                for key in keyboard.read() if ready else "":
                    viewer.press(key)
        viewer.control.pause()
        shown.show({"progress": viewer.progress()})


@contextmanager
def recorded_robot(job: Job) -> Iterator[tuple[RecordedRobot, Span]]:
    """Open the recording of `job`; yield the robot's recorded state and the time span to play."""
    # Here, because only a drawn replay needs these: the import would delay the player by 50 ms.
    from robotctl.recording import Recording
    from robotctl.replay.recorded_robot import RecordedRobot
    from robotctl.replay.timeline import span_of

    with Recording(job.file) as recording:
        span = span_of(recording.info(), job)
        yield RecordedRobot(recording, span, loop=job.loop), span


class _Viewer:
    """A recording that is drawn, at the job's rate and by keys."""

    def __init__(self, job: Job, robot: RecordedRobot, screen: Screen) -> None:
        self.quit = False
        self.control = PlaybackControl(job.rate, time.monotonic_ns, paused=job.paused)
        self.control.begin(time.monotonic_ns() + round(job.delay_s * NS_PER_S))
        self._was_playing = False
        self._robot = robot
        self._screen = screen

    @property
    def position_ns(self) -> int:
        return self.control.schedule.position_ns(time.monotonic_ns())

    def progress(self) -> dict[str, Any]:
        """Return position, rate and pause as the player process reports them."""
        schedule = self.control.schedule
        position_s = self.position_ns / NS_PER_S
        return {"position_s": position_s, "rate": schedule.rate, "paused": schedule.paused}

    def press(self, key: str) -> None:
        self.quit = self.quit or key == QUIT
        if key in COMMAND_OF_KEY:
            carry_out(COMMAND_OF_KEY[key], self.control)
        next_ns = self._robot.next_ns
        if next_ns is not None and self.control.takes_step(next_ns):
            self._robot.advance(next_ns)

    def suspend(self) -> None:
        """Pause the replay before this process stops."""
        self._was_playing = not self.control.schedule.paused
        self.control.pause()
        self._screen.suspend()

    def resume(self) -> None:
        """Continue, unless the replay was paused before `suspend`."""
        self._screen.resume()
        if self._was_playing:
            self.control.resume()
