"""The signals that end a daemon."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator

import pytest

from robotctl.end_signals import end_signals
from tests.support.waiting import loop_until


@pytest.fixture
def under_nohup() -> Iterator[None]:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
async def test_a_signal_ends_it(number: signal.Signals) -> None:
    told = end_signals()
    assert not told.is_set()
    os.kill(os.getpid(), number)
    await loop_until(told.is_set)


async def test_under_nohup_a_closed_terminal_does_not(under_nohup: None) -> None:
    told = end_signals()
    assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    os.kill(os.getpid(), signal.SIGHUP)
    assert not told.is_set()
    os.kill(os.getpid(), signal.SIGTERM)
    await loop_until(told.is_set)
