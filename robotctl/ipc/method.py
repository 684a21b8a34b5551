"""One method of the control socket, as the daemon offers it."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

P = TypeVar("P")


@dataclass(frozen=True, slots=True)
class Method(Generic[P]):
    """A method: its parameters, its handler, and the handler's deadline.

    The handler is called in the loop with the decoded parameters. A RobotctlError that it raises
    is sent to the client with its text and exit code. The handler is cancelled at its deadline and
    when its client disconnects, so its state must be consistent at every await.
    """

    params: type[P]
    handler: Callable[[P], Awaitable[object]]
    deadline_s: float | None = 10.0
    """None: no deadline while the client stays connected."""
