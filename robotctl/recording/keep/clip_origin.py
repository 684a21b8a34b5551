"""Whether a clip holds exactly what its source holds in that time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path

from robotctl.errors import UnreadableFile
from robotctl.recording.format.metadata_names import CLIP_RECORD
from robotctl.recording.keep.clip import clip_messages
from robotctl.recording.read.messages import Message
from robotctl.recording.read.reader import Recording


@dataclass(slots=True)
class Origin:
    """The comparison of a clip with its source; `wrong` is empty if all messages are the same.

    Times are in nanoseconds since the epoch.
    """

    clip: Path
    source: Path
    start_ns: int
    end_ns: int
    messages: int = 0
    wrong: list[str] = field(default_factory=list)


def compare_with_source(clip: Path, source: Path) -> Origin:
    """Compare each message of a clip with its source, a file or a whole recording.

    Raises:
        UnreadableFile: One of them cannot be read, or the first is no clip.
    """
    with Recording(clip) as cut, Recording(source) as whole:
        about = cut.info().metadata.get(CLIP_RECORD, {})
        try:
            origin = Origin(clip, source, int(about["start_ns"]), int(about["end_ns"]))
        except (KeyError, ValueError):
            raise UnreadableFile(
                f"{clip} is no clip: it does not say what it was cut from"
            ) from None
        named = set(about.get("of", "").split(", "))
        missing = named - {path.name for path in whole.info().files}
        if missing:
            origin.wrong.append(f"it was cut from {', '.join(sorted(missing))}, which is not there")
            return origin
        theirs = clip_messages(whole, (origin.start_ns, origin.end_ns), origin.wrong.append)
        for mine, other in zip_longest(_all(cut, origin), theirs):
            if mine != other:
                origin.wrong.append(_difference(mine, other))
                return origin
            origin.messages += 1
    return origin


def _all(clip: Recording, origin: Origin) -> Iterator[Message]:
    topics = {topic.name for topic in clip.info().topics}
    return clip.in_order_written(topics, origin.wrong.append)


def _difference(mine: Message | None, other: Message | None) -> str:
    if mine is None:
        assert other is not None
        return f"it lacks message {other.sequence} of {other.topic}"
    if other is None:
        return f"message {mine.sequence} of {mine.topic} is not in its source"
    return f"message {mine.sequence} of {mine.topic} is not the one of its source"
