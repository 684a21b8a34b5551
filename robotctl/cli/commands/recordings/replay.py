"""replay: its options; `replay_play` plays or draws, `replay_check` re-runs the decisions."""

from __future__ import annotations

import sys
from pathlib import Path
from signal import SIGHUP, SIGQUIT, SIGTERM
from typing import Annotated

import typer

from robotctl.base.domains import requested_domain
from robotctl.base.errors import UsageError
from robotctl.base.paths import DEFAULT_ROBOT, check_robot_name
from robotctl.cli.options import Json, given_options, new_app
from robotctl.cli.targets.driving import interrupted_by
from robotctl.cli.targets.recordings import RecordedBy, file_path, find_recording
from robotctl.cli.ui.text import short_path

app = new_app()

MAX_READ_AHEAD = 1_000_000

_OPTIONS_OF_RERUNS = frozenset(
    {"files", "check", "all_bytes", "what_if", "resim", "robot", "as_json"}
)
"""The options that --check, --what-if and --resim accept."""


@app.command()
def replay(
    context: typer.Context,
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE",
            parser=file_path,
            help="An MCAP file, a recording's folder or name, a URL, or `last`.",
        ),
    ],
    rate: Annotated[
        str,
        typer.Option(metavar="X", help="Times the original speed, or max."),
    ] = "1",
    topics: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Only these topics; repeatable.")
    ] = None,
    regex: Annotated[
        str, typer.Option(metavar="RE", help="Topics whose name matches, in addition to --topics.")
    ] = "",
    exclude: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Leave out these topics; repeatable.")
    ] = None,
    remap: Annotated[
        list[str] | None,
        typer.Option(metavar="OLD:=NEW", help="Publish a topic as another; repeatable."),
    ] = None,
    start_offset: Annotated[
        float, typer.Option(metavar="S", help="Start S seconds into the recording.")
    ] = 0.0,
    play_duration: Annotated[
        float | None,
        typer.Option("--duration", metavar="S", help="Play S seconds of the recording."),
    ] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Re-run the decisions and compare; needs no ROS.")
    ] = False,
    all_bytes: Annotated[
        bool,
        typer.Option("--all-bytes", help="With --check: read every byte of large recordings, too."),
    ] = False,
    what_if: Annotated[
        list[str] | None,
        typer.Option(metavar="KEY=VALUE", help="Re-run with this parameter changed; repeatable."),
    ] = None,
    resim: Annotated[
        bool, typer.Option("--resim", help="Re-run the drive with a simulated robot.")
    ] = False,
    delay: Annotated[float, typer.Option(metavar="S", help="Wait before the first message.")] = 0.0,
    loop: Annotated[bool, typer.Option("--loop", help="Start again at the end.")] = False,
    paused: Annotated[bool, typer.Option("--paused", help="Start paused.")] = False,
    clock: Annotated[
        float | None, typer.Option(metavar="HZ", help="Publish the recorded time as /clock.")
    ] = None,
    wait_for: Annotated[
        int,
        typer.Option(metavar="N", min=0, help="Send nothing before N subscribers have matched."),
    ] = 0,
    service_requests: Annotated[
        bool,
        typer.Option("--publish-service-requests", help="Call services with recorded requests."),
    ] = False,
    read_ahead: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, max=MAX_READ_AHEAD, help="Messages to read ahead."),
    ] = None,
    draw: Annotated[
        bool, typer.Option("--draw", help="Draw the recorded robot in the terminal while playing.")
    ] = False,
    draw_only: Annotated[
        bool, typer.Option("--draw-only", help="Draw the recorded robot; publish nothing.")
    ] = False,
    original_names: Annotated[
        bool, typer.Option("--original-names", help="Leave out the prefix /replay beside a daemon.")
    ] = False,
    force_types: Annotated[
        bool, typer.Option("--force-types", help="Play types whose definition has changed.")
    ] = False,
    domain_id: Annotated[
        int | None,
        typer.Option(
            metavar="N", help="ROS domain [default: ROS_DOMAIN_ID, or the daemon's, or 0]."
        ),
    ] = None,
    robot: RecordedBy = None,
    as_json: Json = False,
) -> None:
    """Publish a recording to ROS with its original timing.

    While a daemon runs in the same ROS domain, all topics get the prefix /replay;
    --original-names leaves it out, unless the robot is moving. Under the original names, velocity
    commands and service requests are withheld unless --topics names them.

    Keys: space pauses, n sends the next message, + and - change the rate, q quits.

    \b
    Examples:
      robotctl replay last
      robotctl replay run.mcap --topics /odom,/tf --rate 2 --loop
      robotctl replay run.mcap --remap /odom:=/old/odom --wait-for 1
      robotctl replay run.mcap --rate max --json
      robotctl replay recordings/* --check
      robotctl replay s3://bucket/robots/run.mcap --check
      robotctl replay run.mcap --resim --what-if tracking.k_y=8
      robotctl replay run.mcap --draw-only --start-offset 30
    """
    if check and (what_if or resim):
        raise UsageError("--check uses the recorded parameters", "leave --what-if and --resim out")
    if all_bytes and not check:
        raise UsageError("--all-bytes goes with --check")
    daemon_robot = check_robot_name(robot or DEFAULT_ROBOT)
    if check or what_if or resim:
        from robotctl.cli.commands.recordings.replay_check import check_command, compare_command

        for option, spelling in given_options(context).items():
            if option not in _OPTIONS_OF_RERUNS:
                wrong = f"{spelling} is only for playing"
                raise UsageError(f"{wrong}; leave it out with --check, --what-if and --resim")
        if check:
            check_command(files, robot, all_bytes=all_bytes, as_json=as_json)
        else:
            compare_command(files, what_if or [], robot, resim=resim, as_json=as_json)
        return
    from robotctl.replay.job import (
        Job,
        check_clock,
        check_regex,
        check_seconds,
        parse_rate,
        parse_remap,
    )
    from robotctl.replay.replay_guard import domain_to_play_in

    domain = requested_domain(domain_id)
    if len(files) > 1:
        raise UsageError(
            f"{len(files)} recordings were given, but only one can be played "
            "(for several files of one recording, give their folder)"
        )
    name = files[0]
    path = find_recording(str(name), robot)
    job = Job(
        file=path.absolute(),
        domain_id=0 if draw_only else domain_to_play_in(domain, daemon_robot),
        rate=parse_rate(rate),
        topics=_names(topics),
        regex=check_regex(regex),
        exclude=_names(exclude),
        remaps=tuple(parse_remap(each) for each in remap or ()),
        start_offset_s=check_seconds("--start-offset", start_offset),
        duration_s=None
        if play_duration is None
        else check_seconds("--duration", play_duration, positive=True),
        delay_s=check_seconds("--delay", delay),
        loop=loop,
        paused=paused,
        clock_hz=None if clock is None else check_clock(clock),
        wait_for=wait_for,
        service_requests=service_requests,
        read_ahead=read_ahead,
        original_names=original_names,
        changed_types=force_types,
        debug="--debug" in sys.argv,
    )
    if path != name and not as_json:
        print(short_path(path), flush=True)
    with interrupted_by((SIGTERM, SIGHUP, SIGQUIT)):
        if draw_only:
            from robotctl.cli.commands.recordings.replay_play import draw_command

            draw_command(job, quiet=as_json)
        else:
            from robotctl.cli.commands.recordings.replay_play import play_command

            play_command(job, draw=draw, as_json=as_json)


def _names(given: list[str] | None) -> tuple[str, ...]:
    """Return the topic names of a repeatable option, with comma-separated values."""
    return tuple(name for text in given or () for name in text.split(",") if name)
