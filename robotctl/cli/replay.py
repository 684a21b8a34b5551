"""replay: a recording to ROS, with its own timing."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from robotctl.cli.options import Json, Robot, new_app
from robotctl.cli.playing import Outcome, play
from robotctl.cli.replay_screen import screen, summary_lines
from robotctl.cli.text import json_text
from robotctl.errors import UsageError
from robotctl.paths import DEFAULT_ROBOT, check_robot_name
from robotctl.replay.job import Job, check_seconds, parse_rate

app = new_app()

MAX_DOMAIN_ID = 232
"""The last ROS domain whose ports exist (DDSI-RTPS 2.5, 9.6.2.3)."""


@app.command()
def replay(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILE", help="An MCAP file, or the folder of a recording."),
    ],
    rate: Annotated[
        str, typer.Option(metavar="X", help="Times the original speed; max: as fast as can be.")
    ] = "1",
    topics: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Only these topics; repeatable.")
    ] = None,
    exclude: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Not these topics; repeatable.")
    ] = None,
    start_offset: Annotated[
        float, typer.Option(metavar="S", help="Begin so many seconds into the recording.")
    ] = 0.0,
    play_duration: Annotated[
        float | None,
        typer.Option("--duration", metavar="S", help="Play so many recorded seconds."),
    ] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Decide again instead, and compare; needs no ROS.")
    ] = False,
    what_if: Annotated[
        list[str] | None,
        typer.Option(metavar="KEY=VALUE", help="Decide again with another parameter; repeatable."),
    ] = None,
    resim: Annotated[
        bool, typer.Option("--resim", help="Drive again with a simulated robot that reacts.")
    ] = False,
    loop: Annotated[bool, typer.Option("--loop", help="Begin again at the end.")] = False,
    force: Annotated[
        bool, typer.Option("--force", help="Original names although a daemon is there.")
    ] = False,
    domain_id: Annotated[
        int | None,
        typer.Option(
            metavar="N", help="ROS domain [default: ROS_DOMAIN_ID, or the daemon's, or 0]."
        ),
    ] = None,
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Publish a recording to ROS with its original timing.

    While a daemon runs in the same ROS domain, everything goes below /replay; --force uses the
    original names, unless the robot is moving. Without a daemon, velocity commands that somebody
    subscribes to are withheld unless they are named in --topics.

    \b
    Examples:
      robotctl replay recordings/robot_20260101_120000
      robotctl replay run.mcap --topics /odom,/tf --rate 2 --loop
      robotctl replay run.mcap --rate max --json
      robotctl replay recordings/* --check
      robotctl replay run.mcap --resim --what-if tracking.k_y=8
    """
    if check and (what_if or resim):
        raise UsageError("--check takes the recorded parameters: leave --what-if and --resim out")
    if check:
        from robotctl.cli.check import check_command

        check_command(files, robot, as_json=as_json)
        return
    if what_if or resim:
        from robotctl.cli.whatif import what_if_command

        what_if_command(files, what_if or [], robot, closed_loop=resim, as_json=as_json)
        return
    job = Job(
        file=_only(files).absolute(),
        robot=check_robot_name(robot),
        domain_id=_domain_id(domain_id),
        rate=parse_rate(rate),
        topics=_names(topics),
        exclude=_names(exclude),
        start_offset_s=check_seconds("--start-offset", start_offset),
        duration_s=None
        if play_duration is None
        else check_seconds("--duration", play_duration, positive=True),
        loop=loop,
        force=force,
        debug="--debug" in sys.argv,
    )
    outcome = Outcome()
    with screen(quiet=as_json) as show:
        play(job, outcome, show)
    if outcome.summary:
        text = json_text(outcome.summary) if as_json else "\n".join(summary_lines(outcome.summary))
        print(text, flush=True)
    if outcome.interrupted:
        raise KeyboardInterrupt
    if outcome.error is not None:
        raise outcome.error


def _only(files: list[Path]) -> Path:
    """The one recording that is played. Raises UsageError."""
    if len(files) > 1:
        raise UsageError(
            f"{len(files)} recordings: one at a time is played "
            "(several files of one recording: give their folder)"
        )
    return files[0]


def _names(given: list[str] | None) -> tuple[str, ...]:
    """Topic names, given one by one or with commas."""
    return tuple(name for text in given or () for name in text.split(",") if name)


def _domain_id(given: int | None) -> int | None:
    """The domain that was asked for. Raises UsageError."""
    text = os.environ.get("ROS_DOMAIN_ID")
    name, value = ("ROS_DOMAIN_ID", text) if given is None else ("--domain-id", str(given))
    if not value:
        return None
    if not value.isdecimal() or int(value) > MAX_DOMAIN_ID:
        raise UsageError(f"{name} is {value!r}: use 0 to {MAX_DOMAIN_ID}")
    return int(value)
