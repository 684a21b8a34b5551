"""Runs one replay from job to summary."""

from __future__ import annotations

import gc
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from typing import Any, Final

from robotctl.base.errors import IN_PARENTHESES, Refused, UnreadableFile
from robotctl.kernel.constants import NS_PER_S
from robotctl.recording import Recording, TopicInfo
from robotctl.replay import plan
from robotctl.replay.job import Job
from robotctl.replay.plan import Route
from robotctl.replay.playback_control import Command, carry_out
from robotctl.replay.player import ClockPublisher, Lateness, Player, Send, SteadyClock
from robotctl.replay.replay_guard import (
    ReplayGuard,
    check_still,
    daemons_in,
    is_command,
    withheld_note,
)
from robotctl.replay.timeline import AHEAD_ENTRIES, ReadAhead, Span, recorded, span_of
from robotctl.ros.executor.loop_thread import FifoScheduling
from robotctl.ros.playback import BLOCKED_S, QUIET_S, ReplaySession, Unpublishable, latched_depth

Emit = Callable[[dict[str, Any]], None]
"""Sends a message with one key: "note", "waiting", "start", "progress" or "summary"."""


class ReplayReport:
    """Sends each note, and collects notes, skipped topics, withheld topics and missing data."""

    def __init__(self, emit: Emit) -> None:
        self.notes: list[str] = []
        self.skipped: dict[str, str] = {}
        self.withheld: dict[str, int] = {}
        """Number of withheld messages by topic."""

        self.missing: list[str] = []
        """Sentences about unreadable parts of the file."""

        self._emit = emit

    def note(self, text: str) -> None:
        """Send `text` as a note, and keep it for the summary, unless `text` is ""."""
        if text:
            self.notes.append(text)
            self._emit({"note": text})

    def skip(self, topic: str, reason: str) -> None:
        """Report that `topic` is not played. `reason` continues a sentence, as in "has no type"."""
        self.skipped[topic] = reason
        self.note(f"{topic} is skipped: it {reason}")

    def withhold(self, route: Route) -> None:
        """Report that no message of a route is sent, for safety."""
        self.withheld[route.topic.name] = route.topic.message_count
        self.note(withheld_note(route))

    def miss(self, sentences: Iterable[str]) -> None:
        """Report unreadable parts of the file. Repeated sentences are ignored."""
        for sentence in sentences:
            if sentence not in self.missing:
                self.missing.append(sentence)
                self.note(f"missing: {sentence}")


BEHIND_S = 0.05
"""A shorter delay does not count as behind."""


def progress(player: Player, ahead: ReadAhead, now_ns: int) -> dict[str, Any]:
    """Return position, rate and counts. `behind` is the number of messages over BEHIND_S late."""
    schedule, position_ns = player.control.schedule, player.position_ns
    behind = 0
    if schedule.rate is not None:
        overdue_ns = round(BEHIND_S * NS_PER_S * schedule.rate)
        due_ns = schedule.position_ns(now_ns)
        if due_ns - position_ns > overdue_ns:
            behind = ahead.count(position_ns, due_ns - overdue_ns)
        position_ns = max(position_ns, due_ns) if not behind else position_ns
    return {
        "position_s": position_ns / NS_PER_S,
        "sent": player.sent,
        "behind": behind,
        "rate": schedule.rate,
        "paused": schedule.paused,
    }


def summary(
    report: ReplayReport, player: Player, routes: Iterable[Route], *, interrupted: bool
) -> dict[str, Any]:
    """Return the summary of a replay, without its file, domain and prefix."""
    topics = player.topics
    return {
        "sent": player.sent,
        "failed": sum(topic.failed for topic in topics.values()),
        "topics": [
            {
                "name": route.topic.name,
                "published": route.name,
                "type": route.topic.type_name,
                "requests": route.requests,
                "sent": topics[route.topic.name].sent,
                "failed": topics[route.topic.name].failed,
            }
            for route in routes
        ],
        "withheld": report.withheld,
        "skipped": report.skipped,
        "timing_error_us": _timing(player.lateness),
        "played_s": player.position_ns / NS_PER_S,
        "interrupted": interrupted,
        "missing": report.missing,
        "notes": report.notes,
    }


def _timing(lateness: Lateness) -> dict[str, float] | None:
    if not lateness.count:
        return None
    return {
        "p50": lateness.quantile_us(0.5),
        "p99": lateness.quantile_us(0.99),
        "max": lateness.max_ns / 1e3,
    }


CLOCK: Final = "/clock"


def playable(
    routes: Sequence[Route], ros: ReplaySession, job: Job, report: ReplayReport
) -> list[Route]:
    """Return the routes that can be played here, and report the others as skipped.

    Raises:
        Refused: An installed type differs from the recorded type, without --force-types.
    """
    reasons = plan.unplayable(route.topic for route in routes)
    if job.clock_hz is not None:
        reasons[CLOCK] = "is published by --clock instead"
    found = []
    for route in routes:
        topic = route.topic
        try:
            if topic.name not in reasons:
                ros.check_type(topic.type_name)
                found.append(route)
        except Unpublishable as error:
            reasons[topic.name] = str(error)
    for name in sorted(reasons.keys() & {route.topic.name for route in routes}):
        report.skip(name, reasons[name])
    _check_definitions([route.topic for route in found], ros, job, report)
    return found


def open_routes(
    routes: Sequence[Route], ros: ReplaySession, job: Job, report: ReplayReport
) -> tuple[list[Route], dict[str, Send]]:
    """Open the routes. Return those that succeed, and a send function by topic. Report the rest."""
    opened: list[Route] = []
    sends: dict[str, Send] = {}
    for route in routes:
        topic = route.topic
        try:
            if route.requests:
                sends[topic.name] = ros.open_requests(route.name, topic.type_name)
            else:
                sends[topic.name] = ros.open(
                    route.name, topic.type_name, topic.offered_qos, patient=job.rate is None
                )
            opened.append(route)
        except Unpublishable as error:
            report.skip(topic.name, str(error))
    return opened, sends


def open_clock(prefix: str, ros: ReplaySession, job: Job, span: Span) -> ClockPublisher | None:
    """Return the publisher of /clock, or None without --clock.

    Raises:
        Refused: Another node publishes the clock topic.
    """
    if job.clock_hz is None:
        return None
    name = f"{prefix}{CLOCK}"
    others = ros.publishers_of(name)
    if others:
        raise Refused(
            f"--clock is refused: {', '.join(others)} publishes {name} already, and time would "
            "jump back and forth (end it, or use another domain: --domain-id)"
        )
    send = ros.open_clock(name)

    # A new pass of --loop sets time back.
    def send_time(position_ns: int) -> None:
        send(span.start_ns + (position_ns % span.pass_ns if job.loop else position_ns))

    return ClockPublisher(round(NS_PER_S / job.clock_hz), send_time)


def _check_definitions(
    topics: Iterable[TopicInfo], ros: ReplaySession, job: Job, report: ReplayReport
) -> None:
    others = [
        f"{topic.name} ({topic.type_name})"
        for topic in topics
        if topic.message_count and not ros.is_same_type(topic.type_name, topic.type_hash)
    ]
    if not others:
        return
    what = f"recorded with another definition than the installed one: {', '.join(others)}"
    if not job.changed_types:
        raise Refused(
            f"{what}; subscribers would misread it",
            "leave it out: --exclude NAME; play it anyway: --force-types",
            sentence=IN_PARENTHESES,
        )
    report.note(f"{what}; --force-types plays it anyway")


PROGRESS_S: Final = 0.1

GUARD_S: Final = 0.5
"""Interval of the safety checks for daemons."""

JOIN_S: Final = 10.0

PRIORITY: Final = 1
"""The lowest priority of SCHED_FIFO, which is enough to wake up in time."""

# A player behind schedule never sleeps.
OVERLOADED_S: Final = 1.0
"""The time behind schedule after which the player loses its real-time priority."""


class Replay:
    """Plays a job. Any thread may call `stop` and `control` at any time."""

    def __init__(self, job: Job, ros: ReplaySession, emit: Emit) -> None:
        self._job = job
        self._ros = ros
        self._emit = emit
        self._stopped = ros.stopped
        self._over = threading.Event()  # set by `stop`, and by the end of the player's thread
        self._report = ReplayReport(emit)
        self._controlling = threading.Lock()
        self._player: Player | None = None
        self._early: list[Command] = []
        """Commands from before there was a player."""

    def stop(self) -> None:
        """End the replay early, with `interrupted` true in its summary."""
        self._stopped.set()
        self._over.set()

    def control(self, command: Command) -> None:
        """Carry out a command now or, without a player yet, as soon as it is created."""
        with self._controlling:
            if self._player is None:
                self._early.append(command)
            else:
                carry_out(command, self._player.control)

    def run(self) -> None:
        """Play to the end, then send the summary.

        Raises:
            UnreadableFile: The file cannot be read, or (after the replay) not completely.
            UsageError: The job requests something that the recording does not have.
            Refused: The replay is or became unsafe, or an installed type differs.
        """
        job, ros = self._job, self._ros
        with Recording(job.file) as recording:
            info = recording.info()
            self._report.miss(info.missing)
            topics, notes = plan.main_types(info.topics)
            for note in notes:
                self._report.note(note)
            routes = plan.routes(topics, plan.selected(topics, job), job)
            span = span_of(info, job)
            if job.original_names:
                check_still(daemons_in(ros.domain_id))  # early, because discovery takes time
            routes = playable(routes, ros, job, self._report)
            guard = ReplayGuard(ros, ros.domain_id, job.topics, original_names=job.original_names)
            # A daemon stops its robot for a second publisher of its commands.
            ros.settle(QUIET_S if any(is_command(r) and guard.names(r) for r in routes) else 0.0)
            if self._stopped.is_set():
                routes = []  # discovery is incomplete, so do not create publishers
            self._report.note(guard.choose_prefix())
            routes = guard.prefixed(routes)
            ticks = open_clock(guard.prefix, ros, job, span)
            for route in guard.withheld(routes):
                routes.remove(route)
                self._report.withhold(route)
            routes, sends = open_routes(routes, ros, job, self._report)
            gc.enable()  # `__main__` has disabled it
            self._wait()
            player = self._play(recording, guard, routes, sends, ticks, span)
        message = summary(self._report, player, routes, interrupted=self._stopped.is_set())
        where = {"file": str(job.file), "domain_id": ros.domain_id, "prefix": guard.prefix}
        self._emit({"summary": where | message})
        if self._report.missing and not self._stopped.is_set():
            raise UnreadableFile(f"{job.file} is incomplete: {'; '.join(self._report.missing)}")

    def _wait(self) -> None:
        """Wait for `wait_for` subscribers, and until publishers and subscribers have matched."""
        ros, expected = self._ros, self._job.wait_for
        if expected:
            ros.wait_for_subscribers(
                expected, lambda there: self._emit({"waiting": {"for": expected, "there": there}})
            )
        ros.wait_for_matches()
        ros.settle()

    def _play(
        self,
        recording: Recording,
        guard: ReplayGuard,
        routes: Sequence[Route],
        sends: dict[str, Send],
        ticks: ClockPublisher | None,
        span: Span,
    ) -> Player:
        job = self._job
        latched = {
            route.topic.name: depth
            for route in routes
            if not route.requests and (depth := latched_depth(route.topic.offered_qos))
        }

        timeline = recorded(
            recording,
            span,
            {route.topic.name: route.topic.type_name for route in routes},
            latched,
            lambda sentence: self._report.miss([sentence]),
            loop=job.loop,
        )
        with ReadAhead(timeline, job.read_ahead or AHEAD_ENTRIES) as ahead:
            player = Player(
                ahead,
                sends,
                rate=job.rate,
                clock=SteadyClock(),
                paused=job.paused,
                delay_ns=round(job.delay_s * NS_PER_S),
                ticks=ticks,
            )
            with self._controlling:
                self._player = player
                for command in self._early:
                    carry_out(command, player.control)
            self._emit({"start": {"length_s": span.length_ns / NS_PER_S, "topics": len(routes)}})
            guard.check()  # again, because waiting may have taken long
            self._run_player(player, ahead, guard)
        self._ros.wait_until_received()
        for topic in self._ros.given_up():
            self._report.note(
                f"a subscriber of {topic} did not acknowledge messages within {BLOCKED_S:g} s; "
                "it may lack some"
            )
        return player

    def _run_player(self, player: Player, ahead: ReadAhead, guard: ReplayGuard) -> None:
        """Run the player in a thread, and meanwhile send progress and check safety."""
        failures: list[BaseException] = []
        scheduling: list[FifoScheduling] = []
        behind = 0

        def run() -> None:
            try:
                if self._job.rate is not None:  # at rate max it would occupy a core
                    scheduling.append(FifoScheduling(PRIORITY))
                player.run()
            except BaseException as failure:  # noqa: BLE001 - raised again in the main thread
                failures.append(failure)
            finally:
                self._over.set()

        gc.freeze()  # a full collection would delay a message
        if self._stopped.is_set():  # stopped while waiting for subscribers
            player.stop()
        thread = threading.Thread(target=run, name="player", daemon=True)
        thread.start()
        guard_at = time.monotonic() + GUARD_S
        over = False
        try:
            while not over:
                over = self._over.wait(PROGRESS_S)
                message = progress(player, ahead, time.monotonic_ns())
                self._emit({"progress": message})
                behind = behind + 1 if message["behind"] else 0
                if behind * PROGRESS_S >= OVERLOADED_S and scheduling:
                    with suppress(ProcessLookupError):  # the thread has just ended
                        scheduling[0].restore()
                if time.monotonic() >= guard_at:
                    guard.check()
                    guard_at = time.monotonic() + GUARD_S
        finally:
            if not over or self._stopped.is_set():
                player.stop()
                ahead.close()
                self._stopped.set()
            thread.join(JOIN_S)
        if failures:
            raise failures[0]
