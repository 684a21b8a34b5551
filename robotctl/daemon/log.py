"""The daemon's log, as lines that a terminal can be shown."""

from __future__ import annotations

import logging


class PlainFormatter(logging.Formatter):
    """Names that others chose neither steer a terminal nor look like an entry of their own."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802 - logging's own name
        """Return the message with control characters escaped and further lines indented."""
        lines = super().formatMessage(record).split("\n")
        return "\n    ".join(_escaped(line) for line in lines)


def _escaped(line: str) -> str:
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)


def log_to_stderr() -> None:
    """Begin to log."""
    handler = logging.StreamHandler()
    handler.setFormatter(PlainFormatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    logging.basicConfig(level=logging.INFO, handlers=[handler])
