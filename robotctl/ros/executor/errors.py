"""The exception classes of the executor."""

from __future__ import annotations


class UnsupportedPlatform(RuntimeError):
    """This platform or middleware cannot announce new data on an eventfd; the text says why."""


class RclCallFailed(RuntimeError):
    """A call of rcl failed; the text holds rcl's own message."""
