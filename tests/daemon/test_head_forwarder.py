"""Heads of the seal are given to a topic and to a program; a program that fails is told."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

import pytest

from robotctl.daemon.recording import head_forwarder
from robotctl.daemon.recording.head_forwarder import HeadForwarder
from robotctl.errors import ConfigError
from robotctl.recording.seal.keyring import Head
from tests.support.waiting import DEADLINE_S


def head(number: int) -> Head:
    return Head(file=f"run_{number}.mcap", number=number, digest=f"{number:064x}")


def writes_into(path: Path) -> str:
    """Return a command line that appends its arguments to a file."""
    program = f"import sys; open({str(path)!r}, 'a').write(' '.join(sys.argv[1:]) + chr(10))"
    return f'{sys.executable} -c "{program}"'


async def test_each_head_is_published_and_given_to_the_program(tmp_path: Path) -> None:
    published: list[str] = []
    forwarder = HeadForwarder(writes_into(tmp_path / "heads"), published.append)
    forwarder.take(head(1))
    await forwarder.finish()
    assert published == [head(1).digest]
    assert (tmp_path / "heads").read_text() == f"{head(1).digest} run_1.mcap\n"
    assert forwarder.problem == ""


async def test_of_heads_that_wait_the_newest_is_given(tmp_path: Path) -> None:
    forwarder = HeadForwarder(writes_into(tmp_path / "heads"), None)
    forwarder.take(head(1))
    forwarder.take(head(2))
    await forwarder.finish()
    assert (tmp_path / "heads").read_text() == f"{head(2).digest} run_2.mcap\n"


@pytest.mark.parametrize(
    ("command", "says"),
    [("/nowhere/at-all", "cannot be started"), ("false", "ended with 1")],
)
async def test_a_program_that_fails_is_told(command: str, says: str) -> None:
    forwarder = HeadForwarder(command, None)
    forwarder.take(head(1))
    await forwarder.finish()
    assert says in forwarder.problem


async def test_a_program_that_hangs_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(head_forwarder, "LAST_TIMEOUT_S", 0.05)
    forwarder = HeadForwarder(f'{sys.executable} -c "import time; time.sleep(600)"', None)
    forwarder.take(head(1))
    async with asyncio.timeout(DEADLINE_S):
        await forwarder.finish()
    assert "was ended" in forwarder.problem


async def test_without_a_program_nothing_runs() -> None:
    forwarder = HeadForwarder("", None)
    forwarder.take(head(1))
    await forwarder.finish()
    assert forwarder.problem == ""


def test_a_malformed_command_line_is_refused() -> None:
    with pytest.raises(ConfigError, match="head_command"):
        HeadForwarder('logger "', None)
