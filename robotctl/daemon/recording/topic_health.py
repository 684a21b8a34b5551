"""Names topics that stop, slow down, speed up, or whose publisher restarts; it reads no clock."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import islice
from typing import Final, Protocol, assert_never

from robotctl.daemon.recording.learned_period import LearnedPeriod
from robotctl.daemon.recording.topic_watch import LOOK_S, TopicWatch, Trouble
from robotctl.kernel.command_types import TWIST, TWIST_STAMPED
from robotctl.kernel.units import NS_PER_S
from robotctl.recording.write.recorder_options import RateByTopic

_log = logging.getLogger(__name__)

LATE_S: Final = 2.0 * LOOK_S
"""After a longer gap between two looks, messages may wait that are not counted yet."""

RECENT_S: Final = 60.0
"""How long `status` names a trouble that is over."""

FORGET_S: Final = 600.0
"""After this silence a learned topic is no longer watched: its node was ended."""

MAX_NAMED: Final = 20
MAX_TROUBLES: Final = 5
MAX_LOGGED: Final = 1_000
"""Limit on the logged sentences: a topic may stop and go without end."""

_STAMP_SLACK_S: Final = 0.1
"""How much older than the last look a message may be that is new: the tap collects for 0.05 s."""

EVENTS: Final = frozenset(
    (
        TWIST,
        TWIST_STAMPED,
        "sensor_msgs/msg/Joy",
        "rcl_interfaces/msg/ParameterEvent",
    )
)
"""Types that are regular for minutes and then end: nothing is wrong when they stop."""


def may_be_learned(topic: str, type_name: str) -> bool:
    """Return whether a topic that is regular should stay so."""
    is_call = "/_action/" in topic or topic.endswith("/_service_event")
    return not (is_call or type_name in EVENTS)


class Arrivals(Protocol):
    """What has arrived on a channel, recorded or not; its values change.

    `expected` maps each publisher (its gid) to the sequence number that it sends next.
    """

    @property
    def arrived(self) -> int:
        """How many messages."""

    @property
    def newest_ns(self) -> int:
        """The log time of the newest one."""

    @property
    def expected(self) -> Mapping[bytes, int]:
        """The next number of each publisher, the oldest publisher first."""


@dataclass(slots=True)
class _Topic:
    name: str
    learning: LearnedPeriod | None
    is_configured: bool = False
    watch: TopicWatch | None = None
    channels: list[Arrivals] = field(default_factory=list)
    count: int = 0
    newest_s: float = 0.0
    since_s: float = 0.0
    """When the trouble began that is told."""

    over: tuple[Trouble, float, float] | None = None
    """The last trouble that is over: what, how long [s], and when it ended."""


class TopicHealth:
    """The watch over all topics; times in seconds on a steady clock, `wall_ns` since the epoch.

    A topic is watched if its rate is configured, or after its first minutes if it is regular
    (LearnedPeriod). Used in the loop's thread only.
    """

    def __init__(self, expected: RateByTopic, names: Iterable[str], now_s: float) -> None:
        """Expect configured rates of topics; those in `names` are missed if they never come."""
        self._expected = expected
        self._topics: dict[str, _Topic] = {}
        self._active: dict[str, _Topic] = {}
        self._told: dict[str, _Topic] = {}
        """The topics that may have a sentence: of 500 topics few ever have one."""

        self._looked_s = now_s
        self._logged = 0
        for name in names:
            self._topic(name, "", learns=False, now_s=now_s)

    @property
    def watched(self) -> int:
        """The number of topics that are watched or learned."""
        return len(self._active)

    def add(
        self,
        name: str,
        type_name: str,
        channel: Arrivals,
        *,
        learns: bool,
        now_s: float,
    ) -> None:
        """Watch a channel of a topic; `learns`: its rate is expected to stay as it is."""
        self._topic(name, type_name, learns=learns, now_s=now_s).channels.append(channel)

    def _topic(self, name: str, type_name: str, *, learns: bool, now_s: float) -> _Topic:
        known = self._topics.get(name)
        if known is not None:
            return known
        topic = self._topics[name] = _Topic(name, None, newest_s=now_s)
        rate_hz = self._expected.of(name, type_name)
        if rate_hz:
            topic.watch = TopicWatch(1.0 / rate_hz, now_s, 0)
            topic.is_configured = True
        elif rate_hz is None and learns:
            topic.learning = LearnedPeriod(0)
        if topic.watch or topic.learning:
            self._active[name] = topic
        return topic

    def look(self, now_s: float, wall_ns: int) -> bool:
        """Look at each topic; return whether one has another trouble than before."""
        elapsed_s, self._looked_s = now_s - self._looked_s, now_s
        late, news = elapsed_s > LATE_S, False
        for topic in list(self._active.values()):
            count = 0
            for channel in topic.channels:
                count += channel.arrived
            if count != topic.count:
                newest_ns = max([each.newest_ns for each in topic.channels])
                age_s = (wall_ns - newest_ns) / NS_PER_S
                topic.newest_s = now_s - min(max(age_s, 0.0), elapsed_s + _STAMP_SLACK_S)
                topic.count = count
            if topic.watch is not None:
                news |= self._look_at(topic, topic.watch, now_s, late=late)
            elif topic.learning is not None:
                self._learn(topic, topic.learning, now_s, late=late)
        return news

    def warnings(self, now_s: float) -> Iterator[str]:
        """Yield a sentence for each trouble of now, and for those of the last RECENT_S."""
        told: list[str] = []
        for topic in list(self._told.values()):
            sentences = list(_sentences(topic, now_s))
            told += sentences
            if not sentences:  # until its trouble changes again
                del self._told[topic.name]
        yield from islice(told, MAX_NAMED)
        if len(told) > MAX_NAMED:
            yield f"{len(told) - MAX_NAMED} more topics have other rates than expected"

    def troubles(self) -> str:
        """Return what is not as expected now, without numbers; "" if nothing is.

        A configured topic without a message is named from the beginning.
        """
        found = [
            f"{topic.name} is {topic.watch.trouble.value}"
            if topic.count
            else f"{topic.name} has no message yet"
            for topic in self._active.values()
            if topic.watch and (topic.watch.trouble is not Trouble.NONE or not topic.count)
        ]
        more = f" and {len(found) - MAX_TROUBLES} more" if len(found) > MAX_TROUBLES else ""
        return ", ".join(found[:MAX_TROUBLES]) + more

    def _look_at(self, topic: _Topic, watch: TopicWatch, now_s: float, *, late: bool) -> bool:
        if late:
            watch.pause(now_s)
        before, restarted_s = watch.trouble, watch.restarted_s
        watch.look(now_s, topic.count, topic.newest_s)
        if len(topic.channels) == 1:
            watch.look_at_publishers(now_s, topic.channels[0].expected)
        if not topic.is_configured and now_s - watch.newest_s >= FORGET_S:
            topic.watch, topic.learning = None, LearnedPeriod(topic.count)
            return True
        if watch.restarted_s != restarted_s:
            self._tell(f"the publisher of {topic.name} was restarted")
        elif watch.trouble is before:
            return False
        self._told[topic.name] = topic
        if watch.trouble is not before:
            if before is not Trouble.NONE:
                topic.over = before, now_s - topic.since_s, now_s
            topic.since_s = watch.newest_s if watch.trouble is Trouble.SILENT else now_s
            self._tell(_trouble(topic, watch, now_s) or f"{topic.name} is as expected again")
        return True

    def _learn(self, topic: _Topic, learning: LearnedPeriod, now_s: float, *, late: bool) -> None:
        period_s = learning.look(now_s, topic.count, topic.newest_s, late=late)
        if period_s is not None:
            topic.watch, topic.learning = TopicWatch(period_s, now_s, topic.count), None
            _log.debug("%s has %.3g messages a second", topic.name, 1.0 / period_s)
        elif learning.has_given_up:
            del self._active[topic.name]

    def _tell(self, sentence: str) -> None:
        self._logged += 1
        if self._logged <= MAX_LOGGED:
            _log.warning("%s", sentence)


def _sentences(topic: _Topic, now_s: float) -> Iterator[str]:
    watch = topic.watch
    if watch is None:
        return
    if trouble := _trouble(topic, watch, now_s):
        yield trouble
    elif topic.over is not None and now_s - topic.over[2] <= RECENT_S:
        what, lasted_s, ended_s = topic.over
        ago_s = now_s - ended_s
        yield f"{topic.name} was {what.value} for {lasted_s:.1f} s, {ago_s:.0f} s ago"
    if watch.restarted_s is not None and now_s - watch.restarted_s <= RECENT_S:
        yield f"the publisher of {topic.name} was restarted {now_s - watch.restarted_s:.0f} s ago"


def _trouble(topic: _Topic, watch: TopicWatch, now_s: float) -> str:
    expected_hz = 1.0 / watch.period_s
    match watch.trouble:
        case Trouble.NONE:
            return ""
        case Trouble.SILENT:
            silent_s = now_s - watch.newest_s
            has = "has been silent for" if topic.count else "has had no message for"
            expected = f"({expected_hz:.3g} messages a second are expected)"
            return f"{topic.name} {has} {silent_s:.1f} s {expected}"
        case Trouble.SLOW | Trouble.FAST:
            rate_hz = watch.rate_hz
            return f"{topic.name} has {rate_hz:.3g} messages a second instead of {expected_hz:.3g}"
        case _:
            assert_never(watch.trouble)
