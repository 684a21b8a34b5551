"""One entry of the decision log: a line of JSON that holds the hash of the line before it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final

MAX_LINE_BYTES: Final = 32_768
"""No entry is longer; of a longer line a reader takes nothing."""

MAX_TEXT: Final = 500
"""Characters that are kept of a text, such as a reason."""

_HASH_CHARACTERS: Final = 16
_RESERVED: Final = ("time_ns", "kind", "prev")


class DecisionKind(StrEnum):
    """What an entry tells."""

    START = "start"
    """A daemon began: `by`, `version`, `software` (digest), `recording`, `observe`."""

    END = "end"
    """The daemon ended in order. A start that no end precedes was a kill or a power cut."""

    SOFTWARE = "software"
    """Versions and content hash, where they differ from those of the start before."""

    CONFIGURATION = "configuration"
    """Every setting, where one differs from those of the start before."""

    MODE = "mode"
    """The mode changed: `from`, `to`, `reason`, `cause`; `latched` or `released` for a stop."""

    REQUEST = "request"
    """A request was granted: `asked`, `by`, `answer`, and `because` if the client gave a reason."""

    REFUSED = "refused"
    """A request was refused: the same."""

    PARAMETER = "parameter"
    """A setting was changed in a running daemon: `key`, `from`, `to`, `by`."""

    REMOVED = "removed"
    """Retention removed a file of a recording: `file`."""

    MORE = "more"
    """`counts` of entries by kind that were not written, from `first_ns` to `last_ns`."""


@dataclass(frozen=True, slots=True)
class Entry:
    """An entry; `time_ns` since the epoch, `values` as JSON.

    `kind` is a `DecisionKind`, or of a later version.
    """

    time_ns: int
    kind: str
    values: Mapping[str, Any]

    def line(self, prev: str) -> bytes:
        """Return the line without its end; `prev` is the hash of the line before it."""
        head = {"time_ns": self.time_ns, "kind": self.kind, "prev": prev}
        values = {key: _bounded(value) for key, value in self.values.items()}
        return json.dumps({**head, **values, **head}, separators=(",", ":")).encode()


def hash_of(line: bytes) -> str:
    """Return what the next line holds as its `prev`."""
    return hashlib.sha256(line).hexdigest()[:_HASH_CHARACTERS]


def parse(line: bytes) -> tuple[Entry, str]:
    """Return the entry of a line, and the hash that it holds of the line before it.

    Raises:
        ValueError: It is no entry.
    """
    if len(line) > MAX_LINE_BYTES:
        raise ValueError("longer than an entry")
    try:
        found = json.loads(line)
        values = {key: value for key, value in found.items() if key not in _RESERVED}
        time_ns, kind, prev = found["time_ns"], found["kind"], found["prev"]
    except (KeyError, AttributeError, TypeError, RecursionError) as error:
        raise ValueError("no entry") from error
    if type(time_ns) is not int or type(kind) is not str or type(prev) is not str:
        raise ValueError("no entry")
    return Entry(time_ns, kind, values), prev


def _bounded(value: object) -> object:
    if isinstance(value, str) and len(value) > MAX_TEXT:
        return f"{value[: MAX_TEXT - 1]}…"
    return value
