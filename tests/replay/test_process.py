"""The replay process obeys lines on stdin, and ends with stdin."""

from __future__ import annotations

import os
import resource
from collections.abc import Awaitable, Callable, Iterator
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import Any

import pytest

from robotctl.cli.commands.replay.play import PLAYER
from robotctl.processes import program, start
from robotctl.replay.job import Job
from robotctl.replay.playback_control import RATES, Command
from tests.support.bags import STRING, Line, text, write_bag
from tests.support.waiting import DEADLINE_S

Until = Callable[[Callable[[], object]], Awaitable[None]]


class Playing:
    """The replay process, controlled as the command line does."""

    def __init__(self, job: Job) -> None:
        self._child = start(program(PLAYER), with_stdin=True)
        self.write(f"{job.to_json()}\n".encode())

    def urgent_threads(self) -> int:
        """Return how many of its threads run under SCHED_FIFO."""
        found = 0
        for thread in Path(f"/proc/{self._child.pid}/task").iterdir():
            with suppress(ProcessLookupError):
                policy = os.sched_getscheduler(int(thread.name))
                found += policy & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO
        return found

    def tell(self, *commands: Command) -> None:
        self.write(b"".join(command.line() for command in commands))

    def end(self) -> tuple[int, dict[str, Any]]:
        """Close its stdin; return exit code and summary."""
        self._child.close_stdin()
        summary: dict[str, Any] = {}
        with suppress(EOFError):
            while True:
                for said in self._child.receive(DEADLINE_S):
                    summary = said.get("summary", summary)
        return self._child.wait(DEADLINE_S) or 0, summary

    def close(self) -> None:
        self._child.close(DEADLINE_S)

    def write(self, data: bytes) -> None:
        self._child.send(data)


@pytest.fixture
def child(domain_id: int, own_sockets: None) -> Iterator[Callable[[Job], Playing]]:
    with ExitStack() as started:

        def begin(job: Job) -> Playing:
            return started.enter_context(closing(Playing(job)))

        yield begin


@pytest.fixture
def play(
    tmp_path: Path, listener: Any, child: Callable[[Job], Playing], domain_id: int
) -> Callable[..., Playing]:
    """A function that plays numbered messages to the listener."""

    def begin(count: int, period_ms: float = 10.0, **options: Any) -> Playing:
        lines = [Line("/alpha", STRING, n * period_ms, text(f"{n}")) for n in range(count)]
        listener.listen("/alpha", STRING)
        file = write_bag(tmp_path / "run.mcap", lines)
        return child(Job(file, domain_id, **options))

    return begin


async def test_steps_and_rates_reach_the_player_also_those_that_were_asked_for_early(
    listener: Any, play: Any, until: Until
) -> None:
    playing = play(4, period_ms=3_600_000.0)
    heard = listener.heard["/alpha"]
    playing.tell(Command.PAUSE, Command.NEXT, Command.NEXT)
    await until(lambda: len(heard) == 2)
    playing.tell(Command.FASTER, Command.NEXT)
    await until(lambda: len(heard) == 3)
    exit_code, summary = playing.end()
    assert (exit_code, summary["sent"], summary["interrupted"]) == (0, 3, True)
    assert heard == [text(f"{n}") for n in range(3)]


async def test_what_is_no_command_stops_nothing(listener: Any, play: Any, until: Until) -> None:
    playing = play(5, paused=True)
    playing.write(b"nonsense\n\xff\n{}\n")
    playing.tell(Command.RESUME)
    await until(lambda: len(listener.heard["/alpha"]) == 5)


async def test_what_is_stopped_before_everybody_is_known_opens_nothing(
    tmp_path: Path, listener: Any, child: Any, domain_id: int
) -> None:
    file = write_bag(tmp_path / "run.mcap", [Line("/alpha", STRING, 0.0, text("alpha"))])
    exit_code, summary = child(Job(file, domain_id)).end()
    assert (exit_code, summary["topics"], summary["interrupted"]) == (0, [], True)


def may_be_urgent() -> bool:
    """Return whether SCHED_FIFO is permitted here."""
    soft_limit, _ = resource.getrlimit(resource.RLIMIT_RTPRIO)
    return os.geteuid() == 0 or soft_limit != 0


@pytest.mark.skipif(not may_be_urgent(), reason="SCHED_FIFO is not permitted here")
async def test_the_thread_that_keeps_time_is_urgent_until_it_stays_behind(
    play: Any, until: Until
) -> None:
    playing = play(1000, loop=True)
    await until(lambda: playing.urgent_threads() == 1)
    playing.tell(*[Command.FASTER] * len(RATES))
    await until(lambda: playing.urgent_threads() == 0)
    exit_code, summary = playing.end()
    assert (exit_code, summary["interrupted"]) == (0, True)


async def test_what_goes_as_fast_as_possible_is_never_urgent(
    listener: Any, play: Any, until: Until
) -> None:
    playing = play(100, rate=None, loop=True)
    await until(lambda: len(listener.heard["/alpha"]) > 100)
    assert playing.urgent_threads() == 0
    playing.end()
