"""teleop: drive by hand, with keys or a gamepad that must be held."""

from __future__ import annotations

import os
import select
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, nullcontext, suppress
from typing import TYPE_CHECKING, Annotated, Any, Final, cast

import typer

from robotctl.base.errors import RobotctlError, UsageError
from robotctl.base.paths import DEFAULT_ROBOT
from robotctl.cli.commands.status import POLL_S
from robotctl.cli.commands.teleop_controls import (
    JOY,
    STAND,
    STEP,
    Controls,
    Gamepad,
    Hands,
    HandsWithoutReleases,
    HandsWithReleases,
    Holding,
    Speeds,
    typed,
)
from robotctl.cli.options import Reason, Robot, new_app
from robotctl.cli.targets.driving import CLOSING_SIGNALS, Background, HeldLease, interrupted_by
from robotctl.cli.targets.requests import asked_by, lease_of_shell
from robotctl.cli.targets.ros_view import ros_view
from robotctl.cli.ui.keys import (
    ASK_EACH_S,
    Key,
    Keyboard,
    KeyEvent,
    KeyParser,
    ReleaseEvents,
    TerminalAnswers,
)
from robotctl.cli.ui.text import is_terminal, printable
from robotctl.ipc.client import Client, command_for
from robotctl.ipc.method_names import SET_MODE, STATUS
from robotctl.ipc.protocol import EMERGENCY_STOP_MODE
from robotctl.kernel.course import MAX_SILENCE_S
from robotctl.kernel.patterns import MAX_SPEED_MPS, MIN_SPEED_MPS

if TYPE_CHECKING:
    from rich.console import RenderableType

    from robotctl.ipc.answers import Status


MAX_TOPICS: Final = 6
"""The maximum number of topics, for a terminal of 24 lines."""

END_S: Final = 1.0
"""The timeout of `suspend` for the end of the last drawing [s]."""


class TeleopScreen:
    """A context in which a thread draws `lines()` and, below them, the status of the robot."""

    def __init__(self, robot: str, lines: Callable[[], list[str]]) -> None:
        self._robot = robot
        self._lines = lines
        self._ended = threading.Event()
        self._drawing: Background[None] | None = None

    def __enter__(self) -> TeleopScreen:
        """Begin to draw."""
        self.resume()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop drawing."""
        self.suspend()

    def resume(self) -> None:
        """Begin to draw, at first or after `suspend`."""
        self._ended.clear()
        self._drawing = Background(self._draw)
        self._drawing.start()

    def suspend(self) -> None:
        """Stop drawing while other programs use the terminal."""
        self._ended.set()
        if self._drawing is not None:
            self._drawing.join(END_S)

    def check(self) -> None:
        """Raise the error that has ended the drawing, if any.

        Raises:
            RobotctlError: The daemon did not return its status.
            OSError: The terminal is gone, or there are too many open files.
        """
        if self._drawing is not None and self._drawing.is_done and not self._ended.is_set():
            self._drawing.result()

    def _draw(self) -> None:
        from rich.live import Live

        # A redirected stdout hides its encoding, and nothing else prints while this is shown.
        with (
            Client(self._robot) as client,
            Live(auto_refresh=False, redirect_stdout=False, redirect_stderr=False) as live,
        ):
            while not self._ended.is_set():
                live.update(view_below(self._lines(), client.call(STATUS)), refresh=True)
                self._ended.wait(POLL_S)


def view_below(lines: list[str], status: Status) -> RenderableType:
    """Return `lines`, and below them the live view of `status`."""
    from rich.console import Group
    from rich.text import Text

    from robotctl.cli.ui.panels import live_view

    few: dict[str, Any] = {**status, "topics": status["topics"][:MAX_TOPICS]}
    return Group(*map(Text, lines), live_view(cast("Status", few)))


PERIOD_S: Final = ASK_EACH_S
"""The period of reading input in a motion, or always if the terminal answers [s]."""

IDLE_S: Final = 0.1
"""The period of reading input while no motion is held [s]."""

WITH_RELEASES: Final[tuple[str, ...]] = (
    "hold w a s d or the arrows; a terminal that is silent for 125 ms is zero",
    "a key that stops repeating is let go in 0.8 s, after another key in 3 s",
)
WITHOUT_RELEASES: Final[tuple[str, ...]] = (
    "hold w a s d or the arrows; nothing moves until the key repeats",
    "this terminal does not report key releases: zero 125 ms after the last repeat",
)
KEYS: Final = "+ - speed   space let go   e emergency stop   q quit"
_FASTER, _SLOWER, _LET_GO, _STOP, _QUIT = "+=", "-", " ", "e", "q"


class Quit(Exception):
    """The operator ended the session, or the terminal is gone."""


class TeleopSession:
    """One session: reads keys or gamepad, requests the motion, and returns the text to show."""

    def __init__(
        self,
        robot: str,
        client: Client,
        params: Mapping[str, Any],
        speeds: Speeds,
        gamepad: Gamepad | None,
    ) -> None:
        self._robot = robot
        self._client = client
        self._params = params
        self._holding = Holding(client, params)
        self._speeds = speeds
        self._gamepad = gamepad
        self._hands: Hands = HandsWithoutReleases()
        self._parser = KeyParser()
        self._answers: TerminalAnswers | None = None
        self._woke_s = time.monotonic()

    def lines(self) -> list[str]:
        """Return the lines for the screen: keys, speeds, and why the last motion ended."""
        how = WITHOUT_RELEASES if self._answers is None else WITH_RELEASES
        if self._gamepad is not None:
            how = (str(self._gamepad),)
        messages = (self._holding.message, self._hands.problem)
        return [
            *how,
            KEYS,
            f"speed {self._speeds}",
            *(printable(message) for message in messages if message),
        ]

    def begin(self, answers: TerminalAnswers | None) -> None:
        """Prepare to read a terminal's keys; `answers` is None if it reports no key releases."""
        self._answers = answers
        self._hands = HandsWithoutReleases() if answers is None else HandsWithReleases()
        self._holding.silence_lets_go = answers is None and self._gamepad is None

    def let_go(self) -> None:
        """Release all keys and the gamepad; the robot ramps down."""
        self._forget()
        self._holding.want(STAND)

    def turn(self, keyboard: Keyboard) -> None:
        """Wait for input, at most for one period, then send the wanted velocity.

        Raises:
            Quit: The operator ended the session, or the terminal is gone.
        """
        period_s = PERIOD_S if self._holding.is_held or self._answers else IDLE_S
        if self._answers is not None:
            self._answers.ask()
        sources: list[Any] = (
            keyboard.sources if self._gamepad is None else [*keyboard.sources, self._gamepad]
        )
        ready, _, _ = select.select(sources, [], [], period_s)
        slept_s, self._woke_s = time.monotonic() - self._woke_s, time.monotonic()
        if slept_s > period_s + MAX_SILENCE_S:
            self._forget_the_past(keyboard)
            return
        keys = list(self._keys(keyboard, ready))
        for key in typed(keys, tells_releases=self._answers is not None):
            if key.event is not KeyEvent.RELEASED:
                self._press(key)
        if self._gamepad is None:
            wish = self._hands.take(keys, self._woke_s)
        else:
            wish = self._gamepad.take() if self._gamepad in ready else None
        if wish is not None and not self._holding.want(self._speeds.velocity(wish)):
            self._forget()

    def _keys(self, keyboard: Keyboard, ready: list[Any]) -> Iterator[Key]:
        if set(ready).isdisjoint(keyboard.sources):
            return
        try:
            text = keyboard.read()
        except OSError:
            raise Quit from None
        if not text and keyboard.has_ended(ready):
            raise Quit
        yield from self._parser.feed(text, self._woke_s)

    def _forget(self) -> None:
        self._hands.forget()
        if self._gamepad is not None:
            self._gamepad.forget()

    def _forget_the_past(self, keyboard: Keyboard) -> None:
        """Release all keys, and drop the unread ones."""
        self._forget()
        keyboard.flush()
        self._parser = KeyParser()
        self._holding.message = "this command was stopped or slow: let go, then hold again"

    def _press(self, key: Key) -> None:
        if key.with_control:  # a terminal that reports releases sends no signals for these
            if key.name == "c":
                raise KeyboardInterrupt
            if key.name == "z":
                os.kill(os.getpid(), signal.SIGTSTP)
        elif key.name in _FASTER:
            self._speeds.scale(STEP)
        elif key.name == _SLOWER:
            self._speeds.scale(1.0 / STEP)
        elif key.name == _LET_GO:
            self.let_go()
        elif key.name == _QUIT:
            raise Quit
        elif key.name == _STOP:
            self._emergency_stop()

    def _emergency_stop(self) -> None:
        self._forget()
        answer = self._client.call(SET_MODE, {**self._params, "mode": EMERGENCY_STOP_MODE})
        cure = f"release it with: {command_for(self._robot, 'reset')}"
        self._holding.message = f"{answer['message']} ({cure})"


app = new_app()

MAX_INPUTS = 64
"""The limit on buttons and on axes of a gamepad."""


@app.command()
def teleop(
    joy: Annotated[
        str,
        typer.Option(metavar="TOPIC", help="Steer with the gamepad of this topic, such as joy."),
    ] = "",
    button: Annotated[
        int, typer.Option(metavar="N", help="The button of the gamepad that must be held.")
    ] = Controls().button,
    axes: Annotated[
        str, typer.Option(metavar="F,L", help="The axes of the gamepad: forward, to the left.")
    ] = "1,0",
    speed: Annotated[
        float | None,
        typer.Option(metavar="M/S", help="Speed at the start [default: half of the limit]."),
    ] = None,
    reason: Reason = "",
    robot: Robot = DEFAULT_ROBOT,
) -> None:
    """Drive by hand: the robot moves while a key or a button of a gamepad is held.

    Where the terminal reports the release of a key, as kitty, foot, WezTerm and Ghostty do, the
    robot ramps down with it, and 125 ms after the terminal's last sign of life the velocity is
    zero. In other terminals nothing moves until the key repeats, and 125 ms after the last repeat
    the velocity is zero; also if the command, which holds the lease, hangs, ends or disconnects.

    \b
    Examples:
      robotctl teleop
      robotctl teleop --speed 0.2
      robotctl teleop --joy joy --button 5
    """
    if speed is not None and not MIN_SPEED_MPS <= speed <= MAX_SPEED_MPS:
        raise UsageError(f"--speed {speed:g}", f"use {MIN_SPEED_MPS:g} to {MAX_SPEED_MPS:g} m/s")
    controls = _controls(button, axes)
    has_terminal = sys.stdin.isatty() and is_terminal()
    if not (joy or has_terminal):
        raise UsageError("teleop needs a terminal", "or a gamepad: robotctl teleop --joy joy")
    with ExitStack() as stack:
        stack.enter_context(interrupted_by(CLOSING_SIGNALS))
        gamepad = None
        if joy:
            view = ros_view(robot, None)
            name = view.full_name(joy)
            listener = stack.enter_context(view.listen(name, JOY, data=True))
            gamepad = Gamepad(listener, name, controls)
        client = stack.enter_context(Client(robot))
        speeds = Speeds(client, speed)
        lease = None
        params: Mapping[str, Any] = {**asked_by("teleop", reason), **lease_of_shell()}
        if "lease" not in params:
            lease = stack.enter_context(HeldLease(robot, "teleop", reason))
            params = {**params, "lease": lease.token}
        session = TeleopSession(robot, client, params, speeds, gamepad)
        try:
            _run(session, robot, lease, has_terminal=has_terminal)
        except Quit:
            pass
        finally:
            with suppress(RobotctlError):  # the first error is the one to report
                session.let_go()


def _run(
    session: TeleopSession, robot: str, lease: HeldLease | None, *, has_terminal: bool
) -> None:
    """Run the session until it or the lease ends."""

    def suspend() -> None:
        session.let_go()
        screen.suspend()
        releases.suspend()

    def resume() -> None:
        releases.resume()
        screen.resume()

    screen = TeleopScreen(robot, session.lines)
    with Keyboard(suspend, resume) as keyboard:
        releases = ReleaseEvents(keyboard.keys_from, sys.stdout.fileno())
        with releases, ExitStack() as stack:
            session.begin(stack.enter_context(TerminalAnswers()) if releases.told else None)
            stack.enter_context(screen if has_terminal else nullcontext())
            while lease is None or not lease.is_over:
                session.turn(keyboard)
                screen.check()
    if lease is not None:
        lease.result()


def _controls(button: int, axes: str) -> Controls:
    """Return the controls of a gamepad.

    Raises:
        UsageError: The number of the button or of an axis is not possible.
    """
    numbers = axes.split(",")
    if len(numbers) != 2 or not all(n.isdecimal() and int(n) < MAX_INPUTS for n in numbers):
        raise UsageError(f"--axes {axes}", "use two numbers, such as 1,0")
    if not 0 <= button < MAX_INPUTS:
        raise UsageError(f"--button {button}", f"use 0 to {MAX_INPUTS - 1}")
    return Controls(button, *map(int, numbers))
