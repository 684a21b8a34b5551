"""A ROS domain of one's own, also against other test runs on this machine."""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from robotctl.domains import free_domain

MAX_TRIES = 1000
"""A domain is chosen at random: far more tries than there are domains."""


@contextmanager
def reserved_domain() -> Iterator[int]:
    """Reserve a domain that no process on this machine uses, until the block ends."""
    folder = Path(tempfile.gettempdir()) / f"robotctl-test-domains-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    for _ in range(MAX_TRIES):
        number = free_domain()
        with (folder / str(number)).open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:  # another test has it, and has not joined it yet
                continue
            yield number
            return
    raise AssertionError("no ROS domain is free")
