"""What the loop of a view tells about failures that no task awaits."""

from __future__ import annotations

import asyncio
import errno
import sys
import time
from typing import Any, Final

_OUT_OF_DESCRIPTORS: Final = frozenset({errno.EMFILE, errno.ENFILE})

SAID_AGAIN_S: Final = 60.0
"""A lack that lasts is said once in this time; asyncio tries to accept each second."""


class LoopFailures:
    """The exception handler of the loop; without a free descriptor, new viewers wait."""

    def __init__(self) -> None:
        self._said_s = -SAID_AGAIN_S

    def handle(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Say in one line that no descriptor is free; leave any other failure to asyncio."""
        error = context.get("exception")
        if not isinstance(error, OSError) or error.errno not in _OUT_OF_DESCRIPTORS:
            loop.default_exception_handler(context)
        elif (now_s := time.monotonic()) - self._said_s >= SAID_AGAIN_S:
            self._said_s = now_s
            print(
                f"robotctl view: {error.strerror}: new viewers wait; raise the limit (ulimit -n), "
                "or close other viewers",
                file=sys.stderr,
                flush=True,
            )
