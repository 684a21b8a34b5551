"""Starts a copy of this process, which has nothing to import."""

from __future__ import annotations

import gc
import os
import signal
import traceback
from collections.abc import Callable, Iterable
from functools import partial
from typing import Final, NoReturn

from robotctl.processes.child import Child
from robotctl.processes.descriptors import open_pipe

_INTERRUPTIONS: Final = (signal.SIGINT, signal.SIGTERM)


def has_one_thread() -> bool:
    """Return whether no other thread runs in this process, so that `fork` may copy it."""
    try:
        return len(os.listdir("/proc/self/task")) == 1
    except OSError:  # no /proc, or no descriptor left
        return False


def fork(work: Callable[[int, int], int | None]) -> Child:
    """Start a copy of this process that ends after `work`; it has nothing to import.

    `work(stdin, reports)` gets two descriptors: one to read our lines from, one for `send_report`.
    It may return an exit code.
    The copy has its own process group, as after `start`. Fork a process with one thread only: a
    lock that another thread holds would stay locked in the copy.

    Raises:
        OSError: There is no memory or no descriptor left.
    """
    ours: list[int] = []
    theirs: list[int] = []
    signals = signal.pthread_sigmask(signal.SIG_BLOCK, _INTERRUPTIONS)
    try:
        reports, reporting = open_pipe()
        ours.append(reports)
        theirs.append(reporting)
        their_stdin, our_stdin = open_pipe()
        ours.append(our_stdin)
        theirs.append(their_stdin)
        pid = os.fork()
        if not pid:
            _run_copy(partial(work, their_stdin, reporting), ours, signals)
        ours.clear()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, signals)
        for descriptor in (*theirs, *ours):
            os.close(descriptor)
    return Child(pid, reports, our_stdin)


def _run_copy(
    work: Callable[[], int | None], ends: Iterable[int], signals: Iterable[signal.Signals | int]
) -> NoReturn:
    """Do the work of a copy, and end it; `ends` are the parent's ends of its pipes."""
    exit_code = 1
    try:
        os.setpgid(0, 0)
        for number in _INTERRUPTIONS:
            signal.signal(number, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_SETMASK, signals)
        for descriptor in ends:
            os.close(descriptor)
        gc.freeze()  # a search through what the parent made would copy its memory
        exit_code = work() or 0
    except BaseException:  # noqa: BLE001 - nothing may go on behind the fork
        traceback.print_exc()
    finally:
        os._exit(exit_code)
