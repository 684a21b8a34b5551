"""Opens the publishers of a replay: each topic that can be played, and the clock."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

from robotctl.errors import IN_PARENTHESES, Refused
from robotctl.kernel.units import NS_PER_S
from robotctl.recording import TopicInfo
from robotctl.replay import plan
from robotctl.replay.job import Job
from robotctl.replay.plan import Route
from robotctl.replay.player import ClockPublisher, Send
from robotctl.replay.replay_report import ReplayReport
from robotctl.replay.timeline import Span
from robotctl.ros.playback.playback import ReplaySession, Unpublishable

CLOCK: Final = "/clock"


def playable(
    routes: Sequence[Route], ros: ReplaySession, job: Job, report: ReplayReport
) -> list[Route]:
    """Return the routes whose types are installed; report the others as skipped.

    Raises:
        Refused: A type has another definition than in the recording, without --force-types.
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
    """Return the routes that could be opened, and the `Send` of each topic; report others as
    skipped.
    """
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
    """Return the publisher of the recorded time, or None without --clock. A loop turns time back.

    Raises:
        Refused: The domain has another clock.
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
