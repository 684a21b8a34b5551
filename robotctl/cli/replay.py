"""replay: a recording to ROS, with its own timing."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import typer

from robotctl.cli.options import Json, Robot, new_app
from robotctl.cli.text import duration, is_terminal, json_text, printable
from robotctl.errors import RobotctlError, UsageError, error_for_exit_code
from robotctl.paths import DEFAULT_ROBOT, check_robot_name
from robotctl.replay.job import Job, check_seconds, parse_rate

app = new_app()

PLAYER = (sys.executable, "-P", "-m", "robotctl.replay")
"""-P: what lies in the working directory is not imported in place of a library."""

MAX_DOMAIN_ID = 232
"""The last ROS domain whose ports exist (DDSI-RTPS 2.5, 9.6.2.3)."""

END_DEADLINE_S = 15.0
"""For the player to take its publishers off the graph and leave."""


@dataclass(slots=True)
class Outcome:
    """What came of a replay, as far as is known."""

    summary: dict[str, Any] = field(default_factory=dict)
    error: RobotctlError | None = None
    interrupted: bool = False
    ended: bool = False
    """The player has nothing more to say."""


@app.command()
def replay(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="An MCAP file, or the folder of a recording.")
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
    """
    job = Job(
        file=file.absolute(),
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
    with _screen(quiet=as_json) as show:
        _play(job, outcome, show)
    if outcome.summary:
        text = json_text(outcome.summary) if as_json else "\n".join(summary_lines(outcome.summary))
        print(text, flush=True)
    if outcome.interrupted:
        raise KeyboardInterrupt
    if outcome.error is not None:
        raise outcome.error


def summary_lines(summary: dict[str, Any]) -> Iterator[str]:
    """What came of a replay, from the object of `replay --json`."""
    domain, names = summary["domain_id"], summary["prefix"]
    where = f"below {names}" if names else "under the original names"
    yield f"  sent        {summary['sent']} messages in ROS domain {domain}, {where}"
    if summary["failed"]:
        yield f"  not sent    {summary['failed']} messages, which the middleware did not take"
    for topic, count in summary["withheld"].items():
        yield f"  withheld    {printable(topic)}, {count} messages"
    for topic, reason in summary["skipped"].items():
        yield f"  skipped     {printable(topic)}: {printable(reason)}"
    timing = summary["timing_error_us"]
    if timing is not None:
        p50, p99, worst = (_microseconds(timing[key]) for key in ("p50", "p99", "max"))
        yield f"  timing      {p50} late p50, {p99} p99, {worst} at most"


def _play(job: Job, outcome: Outcome, show: Callable[[dict[str, Any]], None]) -> None:
    """Have a process play the job and show what it says; the first Ctrl-C asks it to end."""
    process = subprocess.Popen(
        PLAYER,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        process_group=0,  # a Ctrl-C is ours to pass on: it may come while Python starts there
    )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        os.write(process.stdin.fileno(), f"{job.to_json()}\n".encode())
        while not outcome.ended:
            try:
                _take(process.stdout.readline(), outcome, show)
            except KeyboardInterrupt:
                if outcome.interrupted:
                    raise
                outcome.interrupted = True
                process.stdin.close()
    except BrokenPipeError:
        outcome.ended = True
    finally:
        process.stdin.close()
        process.stdout.close()
        try:
            process.wait(END_DEADLINE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
    if not (outcome.summary or outcome.error or outcome.interrupted):
        raise RobotctlError(
            f"the player ended with {process.returncode} before the replay did "
            "(see why with: robotctl --debug replay ...)"
        )


def _take(line: bytes, outcome: Outcome, show: Callable[[dict[str, Any]], None]) -> None:
    if not line:
        outcome.ended = True
        return
    try:
        said = json.loads(line)
    except ValueError:  # the rest of a line that a Ctrl-C has cut
        return
    if "error" in said:
        outcome.error = error_for_exit_code(said["exit_code"], said["error"])
    outcome.summary = said.get("summary", outcome.summary)
    show(said)


@contextmanager
def _screen(*, quiet: bool) -> Iterator[Callable[[dict[str, Any]], None]]:
    """Shows what the player says: notes, and a bar where there is a terminal."""
    if quiet or not is_terminal():

        def show_notes(each: dict[str, Any]) -> None:
            if "note" in each and not quiet:
                print(printable(each["note"]), flush=True)

        yield show_notes
        return
    from rich.progress import BarColumn, Progress, TextColumn

    columns = (
        BarColumn(bar_width=None),
        TextColumn("{task.fields[time]}  {task.fields[sent]} sent{task.fields[late]}"),
    )
    with Progress(*columns, transient=True) as bar:
        task = bar.add_task("", total=None, time="", sent=0, late="")
        length_s = 0.0

        def show(each: dict[str, Any]) -> None:
            nonlocal length_s
            if "note" in each:
                bar.console.print(printable(each["note"]), markup=False, highlight=False)
            elif "start" in each:
                length_s = each["start"]["length_s"]
                bar.update(task, total=length_s)
            elif "progress" in each:
                said = each["progress"]
                position_s = said["position_s"]
                bar.update(
                    task,
                    completed=position_s % length_s if position_s > length_s else position_s,
                    time=f"{position_s:.1f} of {duration(length_s)}",
                    sent=said["sent"],
                    late=f", {said['late_s']:.1f} s behind" if said["late_s"] > 0.1 else "",
                )

        yield show


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


def _microseconds(value: float) -> str:
    return f"{value:.0f} us" if value < 10_000 else f"{value / 1000:.0f} ms"
