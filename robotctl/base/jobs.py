"""Jobs of an event loop in processes of the lowest CPU priority.

    python -m robotctl.base.jobs WORK JOB --report-fd N

WORK is `module:function`. The function gets the JSON object JOB and a function that sends a report.
A RobotctlError becomes the report {"error": text}, or is printed to stderr if nobody reads the
reports.
"""

from __future__ import annotations

import os
import sys

if __name__ == "__main__":
    os.nice(19)  # before the imports, which could delay the control of a robot

import asyncio
import json
from collections.abc import AsyncGenerator, Sequence
from contextlib import aclosing, suppress
from functools import partial
from importlib import import_module
from typing import Any, Final

import msgspec

from robotctl.base.errors import RobotctlError
from robotctl.base.processes import Child, program, report_fd, send_report, start

_END_S: Final = 1.0
"""The time for a process to end after its last report."""


class JobFailed(Exception):
    """The process of a job could not be started, or did not finish the job."""


def job_command(work: str, job: object) -> tuple[str, ...]:
    """Return the command that calls `work`, a `module:function`, with `job` in a new process.

    `job` is a JSON object or a data class; paths in it become strings.
    """
    text = json.dumps(msgspec.to_builtins(job, enc_hook=str))
    return (*program("robotctl.base.jobs"), work, text)


async def run_job(command: Sequence[str]) -> list[dict[str, Any]]:
    """Run the command of a job to its end, and return its reports.

    Raises:
        JobFailed: The process could not be started, reported an error, or failed without one.
    """
    async with aclosing(job_reports(command)) as reports:
        return [report async for report in reports]


async def job_reports(command: Sequence[str]) -> AsyncGenerator[dict[str, Any]]:
    """Run the command of a job, and yield its reports; a cancellation kills the process.

    Raises:
        JobFailed: The process could not be started, reported an error, or failed otherwise.
    """
    starting = asyncio.create_task(asyncio.to_thread(start, command))
    try:
        child = await asyncio.shield(starting)
    except OSError as error:  # no process or no descriptor
        raise JobFailed(str(error)) from error
    except asyncio.CancelledError:
        with suppress(OSError):
            await asyncio.to_thread((await starting).close)
        raise
    failure = ""
    try:
        async with aclosing(reports_of(child)) as reports:
            async for report in reports:
                if "error" in report:
                    failure = report["error"]
                else:
                    yield report
    except ValueError:
        failure = "its process sent an invalid report"
    except (asyncio.CancelledError, GeneratorExit):
        child.kill()
        raise
    finally:
        exit_code = await asyncio.shield(asyncio.to_thread(child.close, _END_S))
    if failure or exit_code:
        raise JobFailed(failure or f"its process ended with {exit_code}")


async def reports_of(child: Child) -> AsyncGenerator[dict[str, Any]]:
    """Yield the reports of a child until it closes its pipe.

    Raises:
        ValueError: The child sent a line that is not a JSON object.
    """
    loop, readable = asyncio.get_running_loop(), asyncio.Event()
    loop.add_reader(child.fileno(), readable.set)
    try:
        while True:
            await readable.wait()
            readable.clear()
            try:
                reports = child.receive(0.0)  # the event may be set for data that were read already
            except TimeoutError:
                continue
            except EOFError:
                return
            for report in reports:
                yield report
    finally:
        loop.remove_reader(child.fileno())


def main(arguments: list[str]) -> int:
    """Do the job and return the exit code."""
    report = partial(send_report, report_fd(arguments))
    work, job = arguments[:2]
    module, _, name = work.partition(":")
    try:
        getattr(import_module(module), name)(json.loads(job), report)
    except BrokenPipeError:  # the process that started this one has ended
        return 1
    except RobotctlError as error:
        try:
            report({"error": str(error)})
        except BrokenPipeError:
            print(f"{work} {job}: {error}", file=sys.stderr)
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
