"""One replay from its job to its summary: puts file, safety rules, ROS and player together."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from typing import Any, Final

from robotctl.errors import Refused, UnreadableFile, UsageError
from robotctl.recording.reader import Message, Recording, RecordingInfo, TopicInfo
from robotctl.replay import plan
from robotctl.replay.clock import SteadyClock
from robotctl.replay.job import Job
from robotctl.replay.neighbours import Daemon, ask, daemons_in
from robotctl.replay.plan import Route
from robotctl.replay.player import Player
from robotctl.replay.read_ahead import ReadAhead
from robotctl.replay.timeline import Span, entries
from robotctl.ros.recorded_qos import latched_depth
from robotctl.ros.replay_session import ReplaySession, Unpublishable

PROGRESS_S: Final = 0.1
GUARD_S: Final = 0.5
"""How often it is made sure that what was safe at the start still is."""

JOIN_S: Final = 10.0

Tell = Callable[[dict[str, Any]], None]
"""Says something to the user: {"note"}, {"start"}, {"progress"} or {"summary"}."""


class Replay:
    """Plays a job. `stop` may be called from any thread, at any time."""

    def __init__(self, job: Job, tell: Tell) -> None:
        self._job = job
        self._tell = tell
        self._stopped = threading.Event()
        self._notes: list[str] = []
        self._skipped: dict[str, str] = {}
        self._withheld: dict[str, int] = {}
        self._missing: list[str] = []
        self._original_names = True
        self._overrides_daemon = False

    def stop(self) -> None:
        """End early; the summary then says so."""
        self._stopped.set()

    def run(self) -> None:
        """Play to the end, then tell the summary.

        Raises:
            UnreadableFile: Nothing can be read; or not everything, after the rest was played.
            UsageError: The job asks for what the recording does not have.
            Refused: It would not be safe, or no longer is.
        """
        job = self._job
        with ExitStack() as stack:
            recording = stack.enter_context(Recording(job.file))
            info = recording.info()
            self._say_missing(info.missing)
            chosen = plan.selected(info.topics, job.topics, job.exclude)
            span = _span(info, job)
            domain_id = self._domain_id()
            if job.force:
                plan.check_still(daemons_in(domain_id))  # before ROS takes its time
            ros = stack.enter_context(ReplaySession(domain_id))
            ros.settle()
            daemons = self._daemons(domain_id, ros)
            prefix, note = plan.prefix_for(daemons, domain_id, force=job.force)
            self._note(note)
            self._overrides_daemon = bool(daemons) and not prefix
            self._original_names = not prefix
            routes = self._routes(chosen, prefix, ros)
            player = self._play(recording, ros, routes, span, domain_id)
        self._tell({"summary": self._summary(player, routes, prefix, domain_id)})
        if self._missing and not self._stopped.is_set():
            raise UnreadableFile(f"{job.file} is incomplete: {'; '.join(self._missing)}")

    def _domain_id(self) -> int:
        """The domain that was asked for, else that of the robot's daemon, else 0."""
        if self._job.domain_id is not None:
            return self._job.domain_id
        daemon = ask(self._job.robot)
        return 0 if daemon is None else daemon.domain_id or 0

    def _daemons(self, domain_id: int, ros: ReplaySession) -> list[Daemon]:
        """Our own, who can be asked, and those that only the ROS graph shows."""
        daemons = daemons_in(domain_id)
        known = {daemon.robot for daemon in daemons}
        others = [Daemon(robot, domain_id, None) for robot in ros.robots_with_daemon()]
        return daemons + [daemon for daemon in others if daemon.robot not in known]

    def _routes(self, chosen: Sequence[TopicInfo], prefix: str, ros: ReplaySession) -> list[Route]:
        """The topics that can be played; what is skipped or withheld is noted."""
        reasons = plan.unplayable(chosen)
        routes = []
        for topic in chosen:
            try:
                if topic.name not in reasons:
                    ros.check_type(topic.type_name)
                    routes.append(Route(topic, plan.published_name(topic.name, prefix)))
            except Unpublishable as error:
                reasons[topic.name] = str(error)
        for name, reason in sorted(reasons.items()):
            self._skip(name, reason)
        withheld = self._unsafe_commands(routes, ros)
        for route in withheld:
            self._withheld[route.topic.name] = route.topic.message_count
            self._note(_withheld_note(route.topic.name))
        return [route for route in routes if route not in withheld]

    def _unsafe_commands(self, routes: Iterable[Route], ros: ReplaySession) -> list[Route]:
        """Commands that a robot would obey; below the prefix there is none, and --force asks so."""
        if not self._original_names or self._overrides_daemon:
            return []
        return plan.withheld_commands(routes, self._job.topics, ros.count_subscribers)

    def _play(
        self,
        recording: Recording,
        ros: ReplaySession,
        routes: list[Route],
        span: Span,
        domain_id: int,
    ) -> Player:
        job = self._job
        sends = {}
        for route in list(routes):
            topic = route.topic
            try:
                sends[topic.name] = ros.open(
                    route.name, topic.type_name, topic.offered_qos, keep_all=job.rate is None
                )
            except Unpublishable as error:
                routes.remove(route)
                self._skip(topic.name, str(error))
        ros.wait_for_matches()

        def read() -> Iterable[Message]:
            return recording.messages(sends.keys(), lambda lost: self._say_missing([lost]))

        latched = {
            route.topic.name: depth
            for route in routes
            if (depth := latched_depth(route.topic.offered_qos))
        }
        timeline = entries(read, span, latched, loop=job.loop)
        with ReadAhead(timeline) as ahead:
            player = Player(ahead, sends, rate=job.rate, clock=SteadyClock())
            self._tell({"start": {"length_s": span.length_ns / 1e9, "topics": len(routes)}})
            self._run_player(player, ahead, ros, routes, domain_id)
        ros.wait_until_received()
        return player

    def _run_player(
        self,
        player: Player,
        ahead: ReadAhead,
        ros: ReplaySession,
        routes: Sequence[Route],
        domain_id: int,
    ) -> None:
        """Let the player run in a thread, tell how far it is, and watch over safety."""
        failures: list[BaseException] = []

        def run() -> None:
            try:
                player.run()
            except BaseException as failure:  # noqa: BLE001 - raised again in the main thread
                failures.append(failure)

        thread = threading.Thread(target=run, name="player", daemon=True)
        thread.start()
        guard_at = time.monotonic() + GUARD_S
        try:
            while thread.is_alive() and not self._stopped.wait(PROGRESS_S):
                self._tell({"progress": _progress(player)})
                if time.monotonic() >= guard_at:
                    self._guard(player, ros, routes, domain_id)
                    guard_at = time.monotonic() + GUARD_S
        finally:
            if thread.is_alive():
                player.stop()
                ahead.close()
                ros.stop()
                thread.join(JOIN_S)
        if failures:
            raise failures[0]

    def _guard(
        self, player: Player, ros: ReplaySession, routes: Sequence[Route], domain_id: int
    ) -> None:
        """Raise Refused where a daemon has come, or begun to move; withhold what turned unsafe."""
        if not self._original_names:
            return
        daemons = self._daemons(domain_id, ros)
        if self._job.force:
            plan.check_still(daemons)
        elif daemons:
            names = ", ".join(repr(daemon.robot) for daemon in daemons)
            raise Refused(
                f"a daemon ({names}) has come into ROS domain {domain_id}: the replay under the "
                "original names has ended (start it again to play below /replay)"
            )
        for route in self._unsafe_commands(routes, ros):
            if route.topic.name not in self._withheld:
                player.withhold(route.topic.name)
                self._withheld[route.topic.name] = 0
                self._note(_withheld_note(route.topic.name))

    def _skip(self, topic: str, reason: str) -> None:
        self._skipped[topic] = reason
        self._note(f"{topic} is skipped: it {reason}")

    def _say_missing(self, sentences: Iterable[str]) -> None:
        for sentence in sentences:
            if sentence not in self._missing:  # a loop meets it again
                self._missing.append(sentence)
                self._note(f"missing: {sentence}")

    def _note(self, text: str) -> None:
        if text:
            self._notes.append(text)
            self._tell({"note": text})

    def _summary(
        self, player: Player, routes: Iterable[Route], prefix: str, domain_id: int
    ) -> dict[str, Any]:
        topics = player.topics
        withheld = dict(self._withheld)
        for name, topic in topics.items():
            if topic.withheld:
                withheld[name] = withheld.get(name, 0) + topic.withheld
        return {
            "file": str(self._job.file),
            "domain_id": domain_id,
            "prefix": prefix,
            "sent": player.sent,
            "failed": sum(topic.failed for topic in topics.values()),
            "topics": [
                {
                    "name": route.topic.name,
                    "published": route.name,
                    "type": route.topic.type_name,
                    "sent": topics[route.topic.name].sent,
                    "failed": topics[route.topic.name].failed,
                }
                for route in routes
            ],
            "withheld": withheld,
            "skipped": self._skipped,
            "timing_error_us": {
                "p50": player.lateness.quantile_us(0.5),
                "p99": player.lateness.quantile_us(0.99),
                "max": player.lateness.max_ns / 1e3,
            }
            if player.lateness.count
            else None,
            "played_s": player.position_ns / 1e9,
            "interrupted": self._stopped.is_set(),
            "missing": self._missing,
            "notes": self._notes,
        }


def _span(info: RecordingInfo, job: Job) -> Span:
    """The part to play. Raises UsageError where that is none."""
    if job.start_offset_s > info.duration_s:
        raise UsageError(
            f"--start-offset {job.start_offset_s:g}: "
            f"the recording ends after {info.duration_s:.1f} s"
        )
    start_ns = info.start_ns + round(job.start_offset_s * 1e9)
    end_ns = info.end_ns
    if job.duration_s is not None:
        end_ns = min(end_ns, start_ns + round(job.duration_s * 1e9))
    return Span(start_ns, end_ns)


def _progress(player: Player) -> dict[str, Any]:
    return {
        "position_s": player.position_ns / 1e9,
        "sent": player.sent,
        "late_s": max(player.late_ns, 0) / 1e9,
    }


def _withheld_note(topic: str) -> str:
    return (
        f"{topic} is withheld: somebody subscribes to it, and a robot would move "
        f"(to send it nevertheless, name it: --topics {topic})"
    )
