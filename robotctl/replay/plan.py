"""The topics of a recording to play, and their names."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from robotctl.base.errors import UsageError

if TYPE_CHECKING:
    from robotctl.recording import TopicInfo
    from robotctl.replay.job import Job

MAX_NAMES_SHOWN: Final = 12

_EVENT_TOPIC: Final = "/_service_event"
_EVENT_TYPE = re.compile(r"[^/]+/srv/[^/]+_Event")


@dataclass(frozen=True, slots=True)
class Route:
    """A recorded topic, and the name of the topic or service that gets its messages."""

    topic: TopicInfo
    name: str
    requests: bool = False
    """Whether the messages are introspection events of a service, with requests to send again."""


def absolute(name: str, prefix: str = "") -> str:
    """Return the absolute name of the recorded topic `name`, with `prefix` before it."""
    return f"{prefix}/{name.lstrip('/')}"


def service_of(topic: TopicInfo) -> str:
    """Return the service of the topic's introspection events, "" if it has no such events."""
    name = absolute(topic.name)
    if name.endswith(_EVENT_TOPIC) and _EVENT_TYPE.fullmatch(topic.type_name):
        return name.removesuffix(_EVENT_TOPIC)
    return ""


def selected(recorded: Sequence[TopicInfo], job: Job) -> list[TopicInfo]:
    """Return the topics to play. `job` may name a service instead of its introspection topic.

    Raises:
        UsageError: A name in --topics is not in the recording.
    """
    wanted, unwanted = ({absolute(name) for name in names} for names in (job.topics, job.exclude))
    _check_recorded("--topics", wanted, recorded)
    pattern = re.compile(job.regex) if job.regex else None

    def is_wanted(topic: TopicInfo) -> bool:
        names = _names(topic)
        if not unwanted.isdisjoint(names):
            return False
        if not wanted and pattern is None:
            return True
        matches = pattern is not None and pattern.search(absolute(topic.name)) is not None
        return matches or not wanted.isdisjoint(names)

    return [topic for topic in recorded if is_wanted(topic)]


def is_named(topic: TopicInfo, names: Collection[str]) -> bool:
    """Return whether `names` contains the topic, or the service of its introspection events."""
    return not _names(topic).isdisjoint(absolute(name) for name in names)


def routes(recorded: Sequence[TopicInfo], chosen: Iterable[TopicInfo], job: Job) -> list[Route]:
    """Return a route for each of the `chosen` topics, remapped but without a prefix.

    Raises:
        UsageError: A remap names an unknown topic, or joins topics of different types.
    """
    renamed = {absolute(old): absolute(new) for old, new in job.remaps}
    _check_recorded("--remap", renamed.keys(), recorded)
    found = []
    for topic in chosen:
        requests = job.service_requests and bool(service_of(topic))
        name = service_of(topic) if requests else absolute(topic.name)
        found.append(Route(topic, renamed.get(name, name), requests))
    types: dict[str, str] = {}
    for route in found:
        type_name = types.setdefault(route.name, route.topic.type_name)
        if renamed and type_name != route.topic.type_name:
            raise UsageError(
                f"--remap: {route.name} would be published both as {type_name} "
                f"and as {route.topic.type_name}"
            )
    return found


def main_types(recorded: Sequence[TopicInfo]) -> tuple[list[TopicInfo], list[str]]:
    """Return the topics to play, and a sentence about each topic with messages left out.

    If over half of the messages of one name have one type, the other types are left out.
    """
    # A node may use another type until it discovers the type that its subscribers want.
    totals: Counter[str] = Counter()
    for topic in recorded:
        totals[topic.name] += topic.message_count
    main = {t.name: t.type_name for t in recorded if 2 * t.message_count > totals[t.name]}
    kept, notes = [], []
    for topic in recorded:
        if main.get(topic.name, topic.type_name) == topic.type_name:
            kept.append(topic)
        elif topic.message_count:
            notes.append(
                f"{topic.message_count} messages of {topic.name} are left out: they are "
                f"{topic.type_name}, and most are {main[topic.name]}"
            )
    return kept, notes


def unplayable(topics: Iterable[TopicInfo]) -> dict[str, str]:
    """Return topic -> reason for the topics that cannot be played on any system."""
    topics = list(topics)
    types = Counter(topic.name for topic in topics)
    reasons = {}
    for topic in topics:
        if types[topic.name] > 1:
            reasons[topic.name] = "is recorded with several types"
        elif topic.encoding != "cdr":
            reasons[topic.name] = f"is encoded as {topic.encoding or 'nothing known'}, not as cdr"
        elif not topic.type_name:
            reasons[topic.name] = "has no type in the file"
    return reasons


def _names(topic: TopicInfo) -> set[str]:
    return {absolute(topic.name), service_of(topic)} - {""}


def _check_recorded(option: str, names: Collection[str], recorded: Iterable[TopicInfo]) -> None:
    there = {name for topic in recorded for name in _names(topic)}
    absent = sorted(set(names) - there)
    if absent:
        shown = ", ".join(sorted(there)[:MAX_NAMES_SHOWN]) or "no topics"
        raise UsageError(f"{option} {', '.join(absent)}: not in the recording, which has {shown}")
