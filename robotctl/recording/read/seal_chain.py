"""The chain of a robot's sealed files, over splits, restarts and days."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final

from robotctl.recording.format.seal_records import Opening
from robotctl.recording.read.source import SUFFIX
from robotctl.recording.read.whole_data import FileState
from robotctl.recording.read.whole_file import WholeFile
from robotctl.recording.seal.heads import KnownHeads

MAX_MISSING: Final = 20
"""Maximum number of missing files that are named."""


@dataclass(slots=True)
class Chain:
    """What the seals of several files say about each other.

    `wrong` has a sentence for each file whose seal does not continue the seal of the file before,
    `absent` a sentence for each gap in the numbers of the files.
    """

    wrong: list[str] = field(default_factory=list)
    absent: list[str] = field(default_factory=list)
    missing: list[tuple[str, int]] = field(default_factory=list)
    """Root key and file number of each file in a gap, at most MAX_MISSING."""


def check_chain(files: Iterable[WholeFile]) -> Chain:
    """Compare each file with the one before it in the chain of the same robot."""
    chain = Chain()
    by_root: dict[str, list[tuple[Opening, WholeFile]]] = {}
    for file in files:
        opening = file.seal.opening
        if opening is not None and file.state is not FileState.CLIP:
            by_root.setdefault(opening.root, []).append((opening, file))
    for pairs in by_root.values():
        _compare(_without_copies(pairs), chain)
    return chain


def _without_copies(
    pairs: Sequence[tuple[Opening, WholeFile]],
) -> list[tuple[Opening, WholeFile]]:
    """Return the files sorted by number, with a copy only if its original is not among them."""
    originals = {opening.number for opening, file in pairs if not file.seal.is_copy}
    copies = {opening.number: (opening, file) for opening, file in pairs if file.seal.is_copy}
    left = [pair for pair in pairs if not pair[1].seal.is_copy]
    left += [pair for number, pair in copies.items() if number not in originals]
    return sorted(left, key=lambda pair: pair[0].number)


def _compare(pairs: Sequence[tuple[Opening, WholeFile]], chain: Chain) -> None:
    for (opening, file), (following, next_file) in pairwise(pairs):
        name, next_name = file.path.name, next_file.path.name
        if following == opening and _are_alike(file, next_file):
            continue
        if following.number == opening.number:
            chain.wrong.append(f"{name} and {next_name} have the same place in the chain")
        elif following.number > opening.number + 1:
            first, last = opening.number + 1, following.number - 1
            which = f"file {first} is" if first == last else f"files {first} to {last} are"
            chain.absent.append(f"{which} not here, between {name} and {next_name}")
            room = MAX_MISSING - len(chain.missing)
            chain.missing += [
                (opening.root, n) for n in range(first, min(last, first + room - 1) + 1)
            ]
        elif following.previous_key != opening.key:
            chain.wrong.append(f"the key of {next_name} is not signed by that of {name}")
        elif following.previous_file != opening.file:
            chain.absent.append(f"{next_name} knows no end of {name}")
        elif not file.seal.is_copy and not file.seal.knows(following.previous):
            chain.wrong.append(
                f"{next_name} continues another end of {name}: "
                "that file was changed, or its tail was cut"
            )


def _are_alike(file: WholeFile, other: WholeFile) -> bool:
    """Return whether one file is a copy of the other in another folder, as `sync` makes them."""
    same_links = bool(file.seal.links) and file.seal.links == other.seal.links
    return same_links and file.path.name == other.path.name


def find_head(files: Iterable[WholeFile], digest: str) -> WholeFile | None:
    """Return the file that has a link with this digest (in hex)."""
    return next((file for file in files if file.seal.knows(digest.lower())), None)


_AS_RECORDED: Final = (FileState.FINISHED, FileState.LIVE, FileState.NOT_CLOSED)
"""The states of a file as the recorder left it; such a file must still have its seal."""


@dataclass(frozen=True, slots=True)
class KnownFile:
    """What this machine knows about a file."""

    listed: bool = False
    """Whether it knows the file's opening."""

    wrong: str = ""
    """Why the file cannot be the known one, or ""."""

    unproved: str = ""
    """Which part of the known seal a repair or a conversion did not keep, or ""."""


def compare_known(file: WholeFile, heads: KnownHeads) -> KnownFile:
    """Return what `heads` say about a file's key, its name, and the name in its seal."""
    opening = file.seal.opening
    name = file.path.name.removesuffix(SUFFIX)
    if opening is None:
        if name not in heads.signed:
            return KnownFile()
        text = "this machine's list of keys knows a seal of it, which is not there"
        if file.state in _AS_RECORDED:
            return KnownFile(wrong=text)
        return KnownFile(unproved=text)
    for known in (name, opening.file):
        keys = heads.keys_of(known)
        if keys and opening.key not in keys:
            return KnownFile(
                wrong=f"this machine's list of keys knows {known} with another key: it was "
                "replaced, or is of another robot of the same name"
            )
    listed = heads.opened.get(opening.key) == opening
    closed = heads.closed.get(opening.key)
    if closed is None or file.seal.knows(closed.digest):
        return KnownFile(listed)
    if file.seal.is_copy:
        return KnownFile(listed, unproved="this machine knows its end, which no copy proves")
    return KnownFile(
        listed, wrong="this machine knows another end of it: a tail was cut or changed"
    )
