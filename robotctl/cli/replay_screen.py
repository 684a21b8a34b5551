"""What is seen of a replay: notes and a bar while it plays, then its summary."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from robotctl.cli.text import duration, is_terminal, printable


@contextmanager
def screen(*, quiet: bool) -> Iterator[Callable[[dict[str, Any]], None]]:
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


def _microseconds(value: float) -> str:
    return f"{value:.0f} us" if value < 10_000 else f"{value / 1000:.0f} ms"
