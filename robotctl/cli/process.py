"""Waiting for a process that may or may not be our child."""

from __future__ import annotations

import os
import select
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def watched(pid: int) -> Iterator[int | None]:
    """A descriptor that becomes readable when the process ends; None where it is out of sight.

    Taken before the process is asked to end: afterwards its pid may be somebody else's.
    """
    try:
        descriptor = os.pidfd_open(pid)
    except OSError:  # gone already, or in another pid namespace
        yield None
        return
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def readable_within(descriptor: int, seconds: float) -> bool:
    """Wait until a descriptor can be read, or for so long."""
    poll = select.poll()
    poll.register(descriptor, select.POLLIN)
    return bool(poll.poll(max(0, int(seconds * 1000))))
