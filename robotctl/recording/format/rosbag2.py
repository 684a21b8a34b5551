"""The folder and `metadata.yaml` (version 9) of rosbag2, formatted as in Jazzy."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from io import TextIOWrapper
from pathlib import Path

from robotctl.base.files import open_regular
from robotctl.base.store import RemoteFile
from robotctl.base.store.objects import is_hash
from robotctl.recording.format.disk import open_private, share_like
from robotctl.recording.format.topics import Topic

METADATA_FILE = "metadata.yaml"
METADATA_RECORD = "rosbag2"
_VERSION = 9
_MAX_METADATA_CHARACTERS = 4 << 20
"""Maximum length of a `metadata.yaml` that is read, enough for 8,000 topics."""

_NO_START_NS = 2**63 - 1
"""The start of a recording without messages, as rosbag2 writes it."""

# A YAML parser needs a second for 1 MB.
# With possessive quantifiers (`*+`) the search time is proportional to the length of any text.
_FILE_LIST = re.compile(r"^ *+relative_file_paths:\n((?: *+- .*+(?:\n|\Z))++)", re.MULTILINE)
_COUNT = r"message_count: *+(\d{1,18}) *+$"
_FILE_COUNT = re.compile(rf"^ *+- path: *+(.++)\n(?:(?! *+- ).*+\n)*? *+{_COUNT}", re.MULTILINE)
_TOPIC_COUNT = re.compile(
    r"^ *+- topic_metadata:\n *+name: *+(.++)\n *+type: *+(.++)\n"
    rf"(?:(?!.*topic_metadata:).*+\n)*? *+{_COUNT}",
    re.MULTILINE,
)
_TOTAL_COUNT = re.compile(rf"^  {_COUNT}", re.MULTILINE)
_QOS_LINE = re.compile(r"(- | {2,})[a-z_]+:( [\w.+-]+)?")


@dataclass(frozen=True, slots=True)
class BagFile:
    """One file of a bag. Times are in ns since the epoch.

    `counts` has message counts by the topic's position in the bag's list of topics.
    """

    name: str
    start_ns: int
    end_ns: int
    counts: Mapping[int, int]

    @property
    def message_count(self) -> int:
        """Messages of all topics."""
        return sum(self.counts.values())


def serialized_metadata(topics: Iterable[Topic], files: Sequence[BagFile]) -> str:
    """Return the body of `metadata.yaml`, without its root key."""
    return "\n".join(_body(topics, files))


def write_metadata(folder: Path, topics: Iterable[Topic], files: Sequence[BagFile]) -> None:
    """Write `metadata.yaml` into `folder`, completely or not at all.

    Raises:
        OSError: The file cannot be written.
    """
    lines = ["rosbag2_bagfile_information:", *_indented(_body(topics, files), 2), ""]
    unfinished = folder / f".{METADATA_FILE}.tmp"
    descriptor = open_private(unfinished, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW)
    with open(descriptor, "w", encoding="utf-8") as stream:
        stream.write("\n".join(lines))
        stream.flush()
        os.fsync(stream.fileno())
    share_like(unfinished, folder)
    unfinished.replace(folder / METADATA_FILE)


def metadata_text(path: Path) -> str:
    """Return the `metadata.yaml` of a recording (folder or file), "" if none can be read."""
    try:
        return read_metadata(path)
    except (OSError, ValueError):
        return ""


def read_metadata(path: Path) -> str:
    """Return the `metadata.yaml` of a recording, "" if there is none or `path` is a URL.

    Raises:
        OSError: The file cannot be read.
        ValueError: The text is not UTF-8, or too long.
    """
    if isinstance(path, RemoteFile):
        return ""
    folder = path if path.is_dir() else path.parent
    if is_hash(folder.name):
        folder = folder.parent
    try:
        with TextIOWrapper(open_regular(_metadata_in(folder)), encoding="utf-8") as stream:
            text = stream.read(_MAX_METADATA_CHARACTERS + 1)
    except FileNotFoundError:
        return ""
    if len(text) > _MAX_METADATA_CHARACTERS:
        raise ValueError(f"it has more than {_MAX_METADATA_CHARACTERS} characters")
    return text


def _metadata_in(folder: Path) -> Path:
    path = folder / METADATA_FILE
    if not path.exists():
        return next((each for each in entries_of(folder) if each.name == METADATA_FILE), path)
    return path


def entries_of(folder: Path) -> list[Path]:
    """Return the files and folders in the folder of a recording.

    They include the files in subfolders named by a hash, made by an earlier `robotctl sync`.

    Raises:
        OSError: A folder cannot be listed.
    """
    entries = list(folder.iterdir())
    folders = [each for each in entries if is_hash(each.name) and each.is_dir()]
    if not folders:
        return entries
    copies = [path for each in folders for path in each.iterdir()]
    copies.sort(key=lambda path: path.lstat().st_mtime_ns)
    newest = {path.name: path for path in copies}
    here = {path.name for path in entries}
    return [*entries, *(path for name, path in newest.items() if name not in here)]


def files_in(text: str) -> list[str]:
    """Return the file names in the text of a `metadata.yaml`, [] without a list of files.

    The list must have one name per line, as rosbag2 and robotctl write it.
    """
    block = _FILE_LIST.search(text)
    if block is None:
        return []
    lines = block[1].splitlines()
    return [Path(line.strip().removeprefix("- ").strip("\"' ")).name for line in lines]


def message_counts_in(text: str) -> dict[str, int]:
    """Return the message counts by file name in the text of a `metadata.yaml`."""
    return {Path(name.strip("\"' ")).name: int(count) for name, count in _FILE_COUNT.findall(text)}


def topic_counts_in(text: str) -> dict[tuple[str, str], int]:
    """Return the message counts by topic name and type in the text of a `metadata.yaml`."""
    counts: dict[tuple[str, str], int] = {}
    for name, kind, count in _TOPIC_COUNT.findall(text):
        key = _unquoted(name), _unquoted(kind)
        counts[key] = counts.get(key, 0) + int(count)
    return counts


def total_count_in(text: str) -> int:
    """Return the total message count in the text of a `metadata.yaml`, 0 if the text has none."""
    found = _TOTAL_COUNT.search(text)
    return int(found[1]) if found else 0


# A YAML library would hold the interpreter lock for 50 ms whenever a new file begins.
def _body(topics: Iterable[Topic], files: Sequence[BagFile]) -> list[str]:
    with_messages = [file for file in files if file.message_count]
    start_ns = min((file.start_ns for file in with_messages), default=_NO_START_NS)
    end_ns = max((file.end_ns for file in with_messages), default=_NO_START_NS)
    lines = [
        f"version: {_VERSION}",
        "storage_identifier: mcap",
        *_span(start_ns, end_ns),
        f"message_count: {sum(file.message_count for file in files)}",
    ]
    entries: list[str] = []
    for position, topic in enumerate(topics):
        count = sum(file.counts.get(position, 0) for file in files)
        entries += _topic(topic, count)
    lines += _list("topics_with_message_count", entries)
    lines += ['compression_format: ""', 'compression_mode: ""']
    lines += _list("relative_file_paths", [f"- {_quoted(file.name)}" for file in files])
    lines.append("files:")
    for file in files:
        empty = file.message_count == 0
        first, last = (_NO_START_NS, _NO_START_NS) if empty else (file.start_ns, file.end_ns)
        lines.append(f"  - path: {_quoted(file.name)}")
        lines += _indented(_span(first, last), 4)
        lines.append(f"    message_count: {file.message_count}")
    return [*lines, "custom_data: ~", "ros_distro: jazzy"]


def _topic(topic: Topic, count: int) -> list[str]:
    # rosbags rejects the whole bag if a message type of a service or an action has a hash.
    type_hash = topic.type_hash if "/msg/" in topic.type_name else ""
    return [
        "- topic_metadata:",
        f"    name: {_quoted(topic.name)}",
        f"    type: {_quoted(topic.type_name)}",
        f"    serialization_format: {_quoted(topic.encoding)}",
        *_indented(_list("offered_qos_profiles", _qos_lines(topic.offered_qos)), 4),
        f"    type_description_hash: {_quoted(type_hash)}",
        f"  message_count: {count}",
    ]


def _span(start_ns: int, end_ns: int) -> list[str]:
    return [
        "duration:",
        f"  nanoseconds: {end_ns - start_ns}",
        "starting_time:",
        f"  nanoseconds_since_epoch: {start_ns}",
    ]


def _list(key: str, lines: Sequence[str]) -> list[str]:
    return [f"{key}:", *_indented(lines, 2)] if lines else [f"{key}: []"]


def _indented(lines: Iterable[str], columns: int) -> list[str]:
    return [" " * columns + line for line in lines]


def _unquoted(text: str) -> str:
    try:
        value = json.loads(text)
    except ValueError:
        value = text.strip("'")
    return value if isinstance(value, str) else text


def _quoted(text: str) -> str:
    """Return `text` in double quotes. JSON and YAML quote names of topics and files alike."""
    return json.dumps(text, ensure_ascii=not text.isprintable())


@lru_cache(maxsize=256)
def _qos_lines(text: str) -> Sequence[str]:
    """Return the lines of a YAML list of QoS profiles, () for other text."""
    lines = text.rstrip().split("\n")
    if not lines[0].startswith("- ") or not all(map(_QOS_LINE.fullmatch, lines)):
        return ()
    return tuple(lines)
