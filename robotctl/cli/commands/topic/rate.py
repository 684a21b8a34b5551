"""topic hz: the rate of a topic."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Annotated, Any, Final

import typer

from robotctl.cli.commands.topic.options import RecordedFile, TopicName, TypeName
from robotctl.cli.options import DomainId, Json, Robot
from robotctl.cli.support.ros_view import ros_view
from robotctl.cli.terminal.text import json_text, moment
from robotctl.errors import Refused
from robotctl.kernel.units import NS_PER_S
from robotctl.paths import DEFAULT_ROBOT

PERIOD_S: Final = 1.0
"""How often the rate is printed."""


def hz(
    topic: TopicName,
    file: RecordedFile = "",
    once: Annotated[bool, typer.Option("--once", help="End after the first result.")] = False,
    window: Annotated[
        int, typer.Option("-w", "--window", min=2, help="Average over the last N messages.")
    ] = 10_000,
    type_name: TypeName = "",
    robot: Robot = DEFAULT_ROBOT,
    domain_id: DomainId = None,
    as_json: Json = False,
) -> None:
    """Show the rate of a topic each second until Ctrl-C, or over a whole recording.

    \b
    Examples:
      robotctl topic hz /odom
      robotctl topic hz --file last /odom --json
    """
    if file:
        _print_recorded(file, topic, type_name, as_json=as_json)
        return
    view = ros_view(robot, domain_id)
    name = view.full_name(topic)
    times_ns: deque[int] = deque(maxlen=window)
    with view.listen(name, type_name, data=False) as listener:
        print_s, before = time.monotonic() + PERIOD_S, 0
        heard = 0
        while True:
            for message in listener.receive(max(print_s - time.monotonic(), 0.0)):
                times_ns.append(message["received_ns"])
                heard += 1
            if time.monotonic() < print_s:
                continue
            print_s += PERIOD_S
            found = statistics(times_ns) if heard > before else None
            before = heard
            if found is not None:
                _print(found, as_json=as_json)
                if once:
                    return
            elif not as_json:
                print("no new messages", flush=True)


def statistics(times_ns: Sequence[int]) -> dict[str, Any] | None:
    """Return rate [Hz] and periods [s] of messages with these times; None of fewer than two.

    The periods are the shortest, the longest, and their standard deviation.
    """
    times = list(times_ns)
    periods_s = [(after - before) / NS_PER_S for before, after in pairwise(times)]
    total_s = sum(periods_s)
    if not periods_s or total_s <= 0:
        return None
    mean_s = total_s / len(periods_s)
    variance = sum((each - mean_s) ** 2 for each in periods_s) / len(periods_s)
    return {
        "rate_hz": 1.0 / mean_s,
        "min_s": min(periods_s),
        "max_s": max(periods_s),
        "std_dev_s": variance**0.5,
        "window": len(times),
    }


def _print(found: Mapping[str, Any], *, as_json: bool) -> None:
    if as_json:
        print(json_text(found), flush=True)
        return
    print(
        f"average rate: {found['rate_hz']:.3f}\n"
        f"\tmin: {found['min_s']:.3f}s max: {found['max_s']:.3f}s "
        f"std dev: {found['std_dev_s']:.5f}s window: {found['window']}",
        flush=True,
    )


def _print_recorded(file: str, topic: str, type_name: str, *, as_json: bool) -> None:
    from robotctl.cli.commands.topic.recorded import RecordedTopic

    recorded = RecordedTopic(file, topic, type_name)
    times_ns = [message.log_ns for message in recorded.messages()]
    found = statistics(times_ns)
    if found is None:
        raise Refused(f"{recorded.name} has {len(times_ns)} messages there: no rate")
    span = {"start_ns": times_ns[0], "end_ns": times_ns[-1]}
    if not as_json:
        print(f"from {moment(times_ns[0])} to {moment(times_ns[-1])}")
    _print(found | span, as_json=as_json)
