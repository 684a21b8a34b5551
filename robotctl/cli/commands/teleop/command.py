"""The options of `robotctl teleop`, and its session from start to end."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from typing import Annotated, Any

import typer

from robotctl.cli.commands.teleop.gamepad import JOY, Controls, Gamepad
from robotctl.cli.commands.teleop.holding import Speeds
from robotctl.cli.commands.teleop.screen import TeleopScreen
from robotctl.cli.commands.teleop.session import Quit, TeleopSession
from robotctl.cli.options import Reason, Robot, new_app
from robotctl.cli.support.held_lease import HeldLease
from robotctl.cli.support.interrupted_drive import CLOSING_SIGNALS
from robotctl.cli.support.quick_actions import asked_by, lease_of_shell
from robotctl.cli.support.ros_view import ros_view
from robotctl.cli.support.signals import interrupted_by
from robotctl.cli.terminal.keyboard import Keyboard
from robotctl.cli.terminal.release_events import ReleaseEvents
from robotctl.cli.terminal.terminal_answers import TerminalAnswers
from robotctl.cli.terminal.text import is_terminal
from robotctl.errors import RobotctlError, UsageError
from robotctl.ipc.client import Client
from robotctl.kernel.patterns import MAX_SPEED_MPS, MIN_SPEED_MPS
from robotctl.paths import DEFAULT_ROBOT

app = new_app()

MAX_INPUTS = 64
"""More buttons or axes than any gamepad has."""


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

    Where the terminal tells the release of a key, as kitty, foot, WezTerm and Ghostty do, the robot
    ramps down with it, and 125 ms after the last sign of life of the terminal the velocity is zero.
    Elsewhere nothing moves until the key repeats, and 125 ms after the last repeat the velocity is
    zero. So it is if this command hangs, ends, or loses its connection. It holds the lease.

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
        gamepad = stack.enter_context(_gamepad(robot, joy, controls)) if joy else None
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
            with suppress(RobotctlError):  # the first failure is the one to tell
                session.let_go()


@contextmanager
def _gamepad(robot: str, topic: str, controls: Controls) -> Iterator[Gamepad]:
    view = ros_view(robot, None)
    name = view.full_name(topic)
    with view.listen(name, JOY, data=True) as listener:
        yield Gamepad(listener, name, controls)


def _run(
    session: TeleopSession, robot: str, lease: HeldLease | None, *, has_terminal: bool
) -> None:
    """Let the operator drive, until the session or the lease ends."""

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
        UsageError: There can be no such button or axis.
    """
    numbers = axes.split(",")
    if len(numbers) != 2 or not all(n.isdecimal() and int(n) < MAX_INPUTS for n in numbers):
        raise UsageError(f"--axes {axes}", "use two numbers, such as 1,0")
    if not 0 <= button < MAX_INPUTS:
        raise UsageError(f"--button {button}", f"use 0 to {MAX_INPUTS - 1}")
    return Controls(button, *map(int, numbers))
