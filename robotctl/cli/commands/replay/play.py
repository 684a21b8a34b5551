"""replay: publish a recording to ROS with its original timing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from robotctl.cli.commands.replay.player_process import play_in_process
from robotctl.cli.support.answer import print_answer
from robotctl.cli.terminal.replay_screen import Screen, screen
from robotctl.cli.terminal.replay_summary import summary_lines
from robotctl.errors import Interrupted
from robotctl.replay.job import Job


def play_command(job: Job, *, draw: bool, as_json: bool) -> None:
    """Publish a recording to ROS, and print the summary; `draw` draws the recorded robot.

    Raises:
        Interrupted: Ctrl-C or a signal ended the replay.
        RobotctlError: The player failed; the error has its exit code.
    """

    @contextmanager
    def open_screen() -> Iterator[Screen]:
        with ExitStack() as stack:
            robot = None
            if draw:
                from robotctl.cli.commands.replay.drawn import recorded_robot

                robot, _ = stack.enter_context(recorded_robot(job))
            yield stack.enter_context(screen(robot, quiet=as_json))

    report = play_in_process(job, open_screen)
    error = Interrupted() if report.interrupted else report.error
    if report.summary:
        lines = summary_lines(report.summary)
        print_answer(report.summary, lines, as_json=as_json, error=error)
    elif error is not None:
        raise error
