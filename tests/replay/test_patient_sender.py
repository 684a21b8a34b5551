"""A replay at full speed waits for subscribers, and for none of them for ever."""

from __future__ import annotations

import threading
import time
from collections.abc import Awaitable, Callable
from types import SimpleNamespace
from typing import Any

import pytest

from robotctl.ros.playback import senders
from robotctl.ros.playback.senders import PatientSender
from tests.support.bags import STRING, Line, text, write_bag

Until = Callable[[Callable[[], object]], Awaitable[None]]


class Publisher:
    """Keeps what was published; `looks` looks for acknowledgements fail before one succeeds."""

    topic_name = "/alpha"
    qos_profile = SimpleNamespace(depth=4)

    def __init__(self, looks: int = 0) -> None:
        self.published: list[bytes] = []
        self.waits: list[int] = []
        self._looks = looks
        self._left = looks

    def publish(self, data: bytes) -> None:
        self.published.append(data)

    def wait_for_all_acked(self, _: object) -> bool:
        if self._left:
            self._left -= 1
            return False
        self._left = self._looks
        self.waits.append(len(self.published))
        return True


def sender_of(publisher: Any, in_flight: int = 3) -> PatientSender:
    return PatientSender(publisher, in_flight, threading.Event())


def test_it_waits_before_more_messages_are_on_their_way() -> None:
    publisher = Publisher(looks=2)
    send = sender_of(publisher)
    assert all(send(b"%d" % number) for number in range(10))
    assert publisher.published == [b"%d" % number for number in range(10)]
    assert (publisher.waits, send.given_up) == ([3, 6, 9], 0)


def test_it_waits_before_the_publisher_forgets_a_message() -> None:
    publisher = Publisher()
    send = sender_of(publisher, in_flight=100)
    for _ in range(9):
        send(b"")
    assert publisher.waits == [4, 8]


def test_it_gives_up_after_a_while_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(senders, "BLOCKED_S", 0.01)
    publisher = Publisher(looks=10**9)
    send = sender_of(publisher)
    assert all(send(b"") for _ in range(8))
    assert (len(publisher.published), send.given_up) == (8, 2)


def test_a_stop_ends_its_wait() -> None:
    publisher: Any = Publisher(looks=10**9)
    stopped = threading.Event()
    send = PatientSender(publisher, 1, stopped)
    send(b"")
    stopped.set()
    begun = time.monotonic()
    send(b"")
    assert time.monotonic() - begun < senders.BLOCKED_S


async def test_a_shallow_subscriber_receives_until_the_end(
    replay: Any, listener: Any, until: Until, tmp_path: Any
) -> None:
    count = 10_000
    lines = [Line("/alpha", STRING, float(number), text(f"{number}")) for number in range(count)]
    file = write_bag(tmp_path / "run.mcap", lines)
    listener.listen("/alpha", STRING, 10)
    ran = await replay(file, "--rate", "max", "--json")
    assert (ran.summary["sent"], ran.summary["failed"]) == (count, 0)
    last = {text(f"{number}") for number in range(count - 500, count)}
    await until(lambda: last.intersection(listener.heard["/alpha"]))
