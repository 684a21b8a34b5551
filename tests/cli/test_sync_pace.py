"""The wait before a piece is sent, which a library may have in a thread of its own."""

from __future__ import annotations

import threading
from collections.abc import Callable

import pytest

from robotctl.cli.support import sync_pace
from robotctl.cli.support.sync_pace import SyncPace
from robotctl.errors import Interrupted, NoDaemon, Refused
from robotctl.ipc.client import NoAnswer

Answers = list[str | Exception]


@pytest.fixture
def answers(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Answers]:
    """Return a function that lets the daemon answer with these modes and errors."""

    def say(*said: str | Exception) -> Answers:
        left = list(said)

        def status(*_: object, **__: object) -> dict[str, str]:
            answer = left.pop(0)
            if isinstance(answer, Exception):
                raise answer
            return {"mode": answer}

        monkeypatch.setattr(sync_pace, "call", status)
        monkeypatch.setattr(SyncPace, "_wait", lambda self, seconds: None)
        return left

    return say


def test_the_end_of_a_run_ends_the_wait_of_another_thread() -> None:
    interrupted = threading.Event()

    def send(pace: SyncPace) -> None:
        try:
            pace(1_000_000_000)  # waits for days
        except Interrupted:
            interrupted.set()

    with SyncPace(0.01, None) as pace:
        threading.Thread(target=send, args=(pace,), daemon=True).start()
    assert interrupted.wait(30)


def test_a_daemon_that_does_not_tell_may_have_a_moving_robot(
    answers: Callable[..., Answers],
) -> None:
    left = answers(
        "IDLE", NoAnswer("silent"), Refused("busy"), "MOVING", NoAnswer("silent"), "IDLE"
    )
    with SyncPace(None, "robot") as pace:
        pace(0)
    assert left == []


def test_a_robot_without_a_daemon_does_not_move(answers: Callable[..., Answers]) -> None:
    left = answers(NoDaemon("none"), NoDaemon("none"), "never asked")
    with SyncPace(None, "robot") as pace:
        pace(1)
    assert left == ["never asked"]


def test_a_daemon_that_cannot_be_asked_at_all_is_told_at_once(
    answers: Callable[..., Answers],
) -> None:
    answers(Refused("the socket belongs to another user"))
    with pytest.raises(Refused, match="another user"), SyncPace(None, "robot"):
        pass
