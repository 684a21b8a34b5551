"""The client whose request is handled now."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

from robotctl.ros.executor.replies import reader_of

_REQUESTER: ContextVar[bytes | None] = ContextVar("requester", default=None)


def requester() -> bytes | None:
    """Return the gid of the client whose request or goal the caller handles.

    It is that of the client's reader of responses, 16 bytes; None where the middleware does not
    tell, and outside of handlers.
    """
    return _REQUESTER.get()


@contextmanager
def request_of(header: Any) -> Iterator[None]:
    """Let `requester` tell the client of the request with this header."""
    token = _REQUESTER.set(reader_of(header))
    try:
        yield
    finally:
        _REQUESTER.reset(token)
