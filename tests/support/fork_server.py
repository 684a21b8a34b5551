"""A server of processes for tests that ends with them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import forkserver, get_context
from multiprocessing.context import ForkServerContext
from typing import Any


@contextmanager
def fork_server(*preloaded: str) -> Iterator[ForkServerContext]:
    """Start processes from a server that has imported some modules, and then end the server."""
    context = get_context("forkserver")
    context.set_forkserver_preload(list(preloaded))
    server: Any = forkserver._forkserver
    try:
        yield context
    finally:
        server._stop()
        context.set_forkserver_preload([])
