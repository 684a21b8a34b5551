"""What this machine knows of sealed files: lines in the journals, which outlive recordings."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field

from robotctl.base.errors import RobotctlError
from robotctl.base.paths import state_folder
from robotctl.decisions.journal import (
    FOLDER,
    DecisionKind,
    Entry,
    OpenedLine,
    entries_in,
    files_of,
    kept_file,
)
from robotctl.recording.format.seal_records import Opening
from robotctl.recording.seal.keyring import (
    OLD_LIST,
    Head,
    entries_of_list,
    is_signed,
    signed_journal,
)


@dataclass(slots=True)
class KnownHeads:
    """The sealed files of all robots: each file's opening and last head, by its public key.

    `signed` has the names of the files that have at least one signed link. `keys` has the public
    keys of the files by name: several files can have the same name if the clock was set back after
    a recording was removed.
    """

    opened: dict[str, Opening] = field(default_factory=dict)
    closed: dict[str, Head] = field(default_factory=dict)
    signed: set[str] = field(default_factory=set)
    keys: dict[str, set[str]] = field(default_factory=dict)

    def add(self, entry: Entry) -> None:
        """Add the opening or the last head that a line of a journal contains.

        Raises:
            ValueError, TypeError, KeyError: The line is malformed.
        """
        if entry.kind == DecisionKind.OPENED:
            opening = _opening(entry)
            self.opened[opening.key] = opening
            self.keys.setdefault(opening.file, set()).add(opening.key)
            if opening.previous_file:  # it continues a signed link
                self.signed.add(opening.previous_file)
        elif entry.kind == DecisionKind.CLOSED:
            values = dict(entry.values[entry.kind])
            key = str(values.pop("key"))
            self.closed[key] = Head(**values)
            self.signed.add(self.closed[key].file)

    def named(self, root: str, number: int) -> str:
        """Return the name of file `number` of the chain with key `root`, "" if it is unknown."""
        found = (
            opening.file
            for opening in self.opened.values()
            if (opening.root, opening.number) == (root, number)
        )
        return next(found, "")


def _opening(entry: Entry) -> Opening:
    return Opening.read(json.dumps(entry.values[entry.kind]).encode())


def known_heads() -> KnownHeads:
    """Return the sealed files that this user's journals know; skip what cannot be read."""
    heads = KnownHeads()
    with suppress(RobotctlError, OSError):
        for robot in state_folder().iterdir():
            journal = robot / FOLDER
            paths = kept_file(journal), *files_of(journal)
            for entries in (
                entries_of_list(robot / "seal" / OLD_LIST),
                *(entries_in(path, DecisionKind.OPENED, DecisionKind.CLOSED) for path in paths),
            ):
                with suppress(OSError):
                    for entry in entries:
                        with suppress(ValueError, TypeError, KeyError):
                            heads.add(entry)
    return heads


def wrong_openings(lines: Iterable[OpenedLine]) -> Iterator[str]:
    """Yield a sentence for each line `opened` whose signature does not fit the lines before."""
    for line in lines:
        proved = False
        with suppress(ValueError, TypeError, KeyError):
            opening, told = _opening(line.entry), line.entry.values["journal"]
            signature = bytes.fromhex(line.entry.values["signature"])
            proved = is_signed(signed_journal(opening, told), signature, opening.key) and all(
                found in (digest, "") for digest, found in zip(told, line.before, strict=True)
            )
        if not proved:
            yield (
                f"{line.place} does not sign the lines before it: "
                "something was changed, removed or added"
            )
