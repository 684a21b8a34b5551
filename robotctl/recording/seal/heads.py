"""The list of a robot's sealed files in its state folder, which outlives the recordings."""

from __future__ import annotations

import json
from collections.abc import Set
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from robotctl.base.files import open_regular
from robotctl.recording.format.seal_records import Opening
from robotctl.recording.seal.keyring import HEADS_FILE, Head

_MAX_BYTES: Final = 256 << 20


@dataclass(slots=True)
class HeadsList:
    """The sealed files of a robot: their openings and last heads, by the file's public key.

    `signed` names the files that have at least one signed link.
    """

    opened: dict[str, Opening] = field(default_factory=dict)
    closed: dict[str, Head] = field(default_factory=dict)
    signed: set[str] = field(default_factory=set)
    _keys: dict[str, set[str]] = field(default_factory=dict)

    def add_opened(self, opening: Opening) -> None:
        """Add an opened file. It continues a signed link, so the previous file is in `signed`."""
        self.opened[opening.key] = opening
        self._keys.setdefault(opening.file, set()).add(opening.key)
        if opening.previous_file:
            self.signed.add(opening.previous_file)

    def add_closed(self, key: str, head: Head) -> None:
        """Add the last head of a file."""
        self.closed[key] = head
        self.signed.add(head.file)

    def keys_of(self, file: str) -> Set[str]:
        """Return the public keys of the files that had this name when they were opened.

        There are several if the clock was set back after a recording was removed.
        """
        return self._keys.get(file, frozenset())

    def named(self, root: str, number: int) -> str:
        """Return the name of file `number` of the chain with key `root`, "" if it is unknown."""
        found = (
            opening.file
            for opening in self.opened.values()
            if (opening.root, opening.number) == (root, number)
        )
        return next(found, "")


def read_heads(folder: Path) -> HeadsList:
    """Return the list in a robot's folder of keys; malformed lines are skipped."""
    heads = HeadsList()
    try:
        with open_regular(folder / HEADS_FILE) as stream:
            lines = stream.read(_MAX_BYTES).decode(errors="replace").splitlines()
    except OSError:
        return heads
    for line in lines:
        try:
            _take(json.loads(line), heads)
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
            continue
    return heads


def _take(entry: dict[str, dict[str, object]], heads: HeadsList) -> None:
    if "opened" in entry:
        opening = Opening.read(json.dumps(entry["opened"]).encode())
        heads.add_opened(opening)
    elif "closed" in entry:
        values = dict(entry["closed"])
        key = str(values.pop("key"))
        heads.add_closed(key, Head(**values))  # type: ignore[arg-type]
