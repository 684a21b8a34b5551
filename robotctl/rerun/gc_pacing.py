"""Lets Python search rarely for reference cycles while many objects are made that form none."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

NEW_OBJECTS: Final = 20_000
"""How many more objects there are before the next search; Python's default is 700."""


@contextmanager
def rare_collections() -> Iterator[None]:
    """Search rarely within the `with` block or the decorated function; if at all, as before."""
    before = gc.get_threshold()
    if before[0]:
        gc.set_threshold(max(NEW_OBJECTS, before[0]), *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)
