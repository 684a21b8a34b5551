"""Which files belong to a recording."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from shlex import quote
from stat import S_ISDIR, S_ISREG

from robotctl.base.errors import UnreadableFile
from robotctl.base.files import open_regular
from robotctl.recording.disk.access import size_of
from robotctl.recording.format.names import natural_order
from robotctl.recording.format.records import MAGIC
from robotctl.recording.format.rosbag2 import METADATA_FILE, entries_of, files_in, read_metadata
from robotctl.recording.read.source import SUFFIX

Progress = Callable[[int, int], None]
"""Called with the bytes done, and the bytes in total."""

SQLITE_SUFFIX = ".db3"
"""Suffix of the files of rosbag2's sqlite3 storage."""

DENIED_CURE = "run this as its owner, or record with recording.group_readable: true"

_FILES_OF_RECORDINGS = (
    *("*.mcap", f"*.mcap{SUFFIX}", f"*{SQLITE_SUFFIX}*", METADATA_FILE),
    "*/*.mcap",
    f"*/{'[0-9a-f]' * 64}/*.mcap",
)
"""Patterns for the content of a folder that is a recording, or holds recordings."""


def recording_files(path: Path) -> list[Path]:
    """Return the MCAP files of a recording, in their order.

    Raises:
        UnreadableFile: There are none, or `path` is not a recording.
    """
    try:
        mode = path.stat().st_mode
        found = files_of_bag(path) if S_ISDIR(mode) else [path]
    except (OSError, ValueError) as error:
        raise UnreadableFile(f"{path} cannot be read: {reason_of(error)}") from error
    if not (S_ISDIR(mode) or S_ISREG(mode)):
        raise UnreadableFile(f"{path} is not a file", "give an MCAP file or a recording's folder")
    if path.suffix == SQLITE_SUFFIX or (not found and any(path.glob(f"*{SQLITE_SUFFIX}*"))):
        raise UnreadableFile(
            f"{path} is a bag in sqlite3 format",
            f"robotctl convert {quote(str(path))} {quote(path.stem + '_mcap')}",
        )
    if not found:
        raise UnreadableFile(f"{path} holds no .mcap file")
    return found


def reason_of(error: OSError | ValueError) -> str:
    """Return why a file cannot be read, and what to do if this user lacks the permission."""
    reason = getattr(error, "strerror", None) or str(error) or repr(error)
    return f"{reason} ({DENIED_CURE})" if isinstance(error, PermissionError) else reason


def metadata_of_folder(folder: Path) -> tuple[str, list[str]]:
    """Return the text of `metadata.yaml` ("" without one), and a sentence if it cannot be read."""
    try:
        return read_metadata(folder), []
    except (OSError, ValueError) as error:
        return "", [f"{METADATA_FILE} cannot be read: {reason_of(error)}"]


def may_not_be_listed(path: Path) -> bool:
    """Return whether `path` is a folder that this user may not list.

    `Path.glob` would find nothing in it. The file system's own `lost+found` does not count.
    """
    try:
        next(path.iterdir(), None)
    except PermissionError:
        return path.name != "lost+found"
    except OSError:
        pass
    return False


def is_bag(path: Path) -> bool:
    """Return whether a path is a folder with MCAP files, or one that this user may not list."""
    if not path.is_dir():
        return False
    try:
        return any(each.suffix == ".mcap" for each in entries_of(path))
    except OSError:
        return may_not_be_listed(path)


def is_recording(path: Path) -> bool:
    """Return whether a path is a recording or a folder of recordings, by names and first bytes.

    Also True for a damaged recording, and for a path that cannot be examined: the reader then
    reports what is wrong.
    """
    try:
        mode = path.stat().st_mode
        if S_ISDIR(mode):
            found = any(next(path.glob(pattern), None) for pattern in _FILES_OF_RECORDINGS)
            return found or may_not_be_listed(path)
        if path.suffix in (".mcap", SQLITE_SUFFIX) or path.name.endswith(f".mcap{SUFFIX}"):
            return True
        if not S_ISREG(mode):
            return False
        with open_regular(path) as file:
            return file.read(len(MAGIC)) == MAGIC
    except (OSError, ValueError):
        return True


def files_of_bag(folder: Path) -> list[Path]:
    """Return the MCAP files in a folder, including those that are compressed as a whole.

    Raises:
        OSError: The folder cannot be listed.
    """
    entries = entries_of(folder)  # unlike glob, it raises where the user may not list
    files = [path for path in entries if path.name.endswith(".mcap")]
    names = {path.name for path in files}
    packed = [
        path for path in entries if path.name.endswith(f".mcap{SUFFIX}") and path.stem not in names
    ]
    return sorted([*files, *packed], key=natural_order)


def each_with_progress(
    paths: Sequence[Path], on_progress: Progress
) -> Iterator[tuple[Path, Progress]]:
    """Yield each path, and the function to call with what is done of it, and in total.

    It calls `on_progress` with the bytes done of all paths, and in total.
    """
    sizes = [size_of(path) for path in paths]
    total = sum(sizes)
    for number, path in enumerate(paths):
        before, size = sum(sizes[:number]), sizes[number]

        def tell(done: int, of: int, before: int = before, size: int = size) -> None:
            on_progress(before + min(done, of) * size // max(of, 1), total)

        yield path, tell


def absent_files(text: str, present: list[Path]) -> list[str]:
    """Return a sentence for each file that `text`, a `metadata.yaml`, lists and `present` lacks."""
    return [
        f"{name}: metadata.yaml names it, but it is not there"
        for name in absent_names(text, present)
    ]


def absent_names(text: str, present: list[Path]) -> list[str]:
    """Return the files that `metadata.yaml` lists and that are not in `present`.

    A file also counts as present in its compressed or decompressed form. `text` is the content of
    `metadata.yaml`; read it before listing the folder, because a daemon lists a file there only
    after creating it.
    """
    names = {path.name.removesuffix(SUFFIX) for path in present}
    return [name for name in files_in(text) if name.removesuffix(SUFFIX) not in names]
