"""What the lists of sealed files on this machine know about a file that was checked."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

from robotctl.errors import RobotctlError
from robotctl.paths import check_robot_name, seal_folder, state_folder
from robotctl.recording.format.seal_records import Opening
from robotctl.recording.read.seal_chain import SealedFile
from robotctl.recording.read.whole_file import FileState
from robotctl.recording.read.zstd_file import SUFFIX
from robotctl.recording.seal.heads import HeadsList, read_heads

_AS_RECORDED: Final = (FileState.FINISHED, FileState.LIVE, FileState.NOT_CLOSED)
"""What claims to be the file of the recorder itself, and so has the seal that it was given."""


@dataclass(frozen=True, slots=True)
class KnownFile:
    """What is known of one file: whether it is `listed` as it is, and two sentences or "".

    `wrong` says why it cannot be the file that a list knows; `unproved` says that a list knows its
    seal, which a repair or a conversion has not kept.
    """

    listed: bool = False
    wrong: str = ""
    unproved: str = ""


class KnownHeads:
    """The lists in this user's state folder; each is read once, when it is needed."""

    def __init__(self) -> None:
        """Find the robots that have a list."""
        self._lists: dict[str, HeadsList] = {}
        self._robots: list[str] = []
        with suppress(RobotctlError, OSError):
            self._robots = sorted(each.name for each in state_folder().iterdir() if each.is_dir())

    def of_robot(self, robot: str) -> HeadsList:
        """Return the list of a robot; it is empty if there is none."""
        if robot not in self._lists:
            try:
                self._lists[robot] = read_heads(seal_folder(check_robot_name(robot)))
            except RobotctlError:
                self._lists[robot] = HeadsList()
        return self._lists[robot]

    def compare(self, file: SealedFile) -> KnownFile:
        """Compare a file with the lists, by its key, its own name, and its name in the seal."""
        opening = file.seal.opening
        name = file.path.name.removesuffix(SUFFIX)
        lists = list(self._lists_for(name, opening))
        if opening is None:
            if not any(name in heads.signed for heads in lists):
                return KnownFile()
            text = "this machine's list of keys knows a seal of it, which is not there"
            if file.state in _AS_RECORDED:
                return KnownFile(wrong=text)
            return KnownFile(unproved=text)
        for known in dict.fromkeys((name, opening.file)):
            keys = {key for heads in lists for key in heads.keys_of(known)}
            if keys and opening.key not in keys:
                return KnownFile(
                    wrong=f"this machine's list of keys knows {known} with another key: it was "
                    "replaced, or is of another robot of the same name"
                )
        heads = self.of_robot(opening.robot)
        listed = heads.opened.get(opening.key) == opening
        closed = heads.closed.get(opening.key)
        if closed is None or file.seal.knows(closed.digest):
            return KnownFile(listed)
        if file.seal.is_copy:
            return KnownFile(listed, unproved="this machine knows its end, which no copy proves")
        return KnownFile(
            listed, wrong="this machine knows another end of it: a tail was cut or changed"
        )

    def _lists_for(self, name: str, opening: Opening | None) -> Iterator[HeadsList]:
        """Yield the lists that may know a file: a forged seal may name another robot."""
        robots = [robot for robot in self._robots if name.startswith(f"{robot}_")]
        if opening is not None:
            robots.append(opening.robot)
        for robot in dict.fromkeys(robots):
            yield self.of_robot(robot)
