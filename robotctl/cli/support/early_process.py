"""A child process that starts while this one imports the option parser, which takes as long."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from robotctl.processes import Child, start

END_S: Final = 10.0
"""How long a process may take to end."""

_waiting: dict[tuple[str, ...], Child] = {}
"""The processes that were started early, by their commands, until they are used."""


@contextmanager
def started_early(command: tuple[str, ...]) -> Iterator[None]:
    """Start a process that `early_or_new` may use; kill it at the end if it was not used."""
    _waiting[command] = start(command, with_stdin=True)
    try:
        yield
    finally:
        unused = _waiting.pop(command, None)
        if unused is not None:
            unused.kill()
            unused.close(END_S)


def early_or_new(command: tuple[str, ...]) -> Child:
    """Return a process that runs the command, with a pipe as its stdin; the caller closes it."""
    return _waiting.pop(command, None) or start(command, with_stdin=True)
