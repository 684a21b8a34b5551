"""A gamepad steers while its button is held; odd messages and a second gamepad move nothing."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from math import inf, nan
from typing import Any, cast

import pytest

from robotctl.cli.commands.teleop import controls as module
from robotctl.cli.commands.teleop.controls import JOY, SILENT_S, STAND, Controls, Gamepad, Wish
from robotctl.cli.targets.ros_view import MessageListener
from robotctl.messages.definition import parse_definition
from robotctl.messages.values import encode

TEXT = "float32[] axes\nint32[] buttons\n"
DEFINITION = parse_definition(JOY, TEXT)
STICK = (0.5, 1.0)


class Fake:
    """A listener whose messages the test gives."""

    type_name, definition = JOY, TEXT

    def __init__(self) -> None:
        self.waiting: list[dict[str, Any]] = []

    def receive(self, seconds: float) -> Iterator[dict[str, Any]]:
        yield from self.waiting
        self.waiting.clear()


@pytest.fixture
def now(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time [s], which the test moves."""
    moment = [100.0]
    monkeypatch.setattr(f"{module.__name__}.time.monotonic", lambda: moment[0])
    return moment


class Hands:
    def __init__(self) -> None:
        self.listener = Fake()
        self.gamepad = Gamepad(cast("MessageListener", self.listener), "/joy", Controls())

    def say(
        self, held: bool, axes: tuple[float, ...] = STICK, by: str = "aa", buttons: int = 5
    ) -> Wish | None:
        pressed = [0] * (buttons - 1) + [int(held)]
        data = encode(DEFINITION, {"axes": list(axes), "buttons": pressed})
        self.listener.waiting.append(
            {"data": base64.b64encode(data).decode(), "publisher": by, "received_ns": 0}
        )
        return self.gamepad.take()


def test_a_button_that_is_down_already_must_be_released_first(now: list[float]) -> None:
    hands = Hands()
    assert hands.say(held=True) == STAND
    assert hands.say(held=False) == STAND
    assert hands.say(held=True) == Wish(1.0, 0.5)
    assert hands.say(held=False) == STAND
    assert hands.gamepad.take() is None, "silence"
    hands.gamepad.forget()
    assert hands.say(held=True) == STAND


def test_the_screen_says_to_let_go_first_and_then_to_hold(now: list[float]) -> None:
    hands = Hands()
    hands.say(held=True)
    assert str(hands.gamepad) == "let go of button 4 of /joy first"
    hands.say(held=False)
    assert str(hands.gamepad) == "hold button 4 of /joy, and steer"
    hands.say(held=True)
    hands.gamepad.forget()
    assert str(hands.gamepad) == "let go of button 4 of /joy first"


def test_a_button_that_is_down_counts_no_sooner_for_a_stick_at_rest(now: list[float]) -> None:
    hands = Hands()
    assert hands.say(held=True, axes=(0.0, 0.0)) == STAND
    assert hands.say(held=True) == STAND, "the button was down all the time"


def test_a_gamepad_that_is_silent_is_told(now: list[float]) -> None:
    hands = Hands()
    assert "nothing is heard on /joy: connect the gamepad" in str(hands.gamepad)
    hands.say(held=False)
    now[0] += SILENT_S
    assert "nothing is heard" not in str(hands.gamepad)
    now[0] += 0.1
    assert "nothing is heard on /joy" in str(hands.gamepad)


@pytest.mark.parametrize("axes", [(nan, nan), (inf, -inf)])
def test_an_axis_that_is_no_number_is_at_rest(now: list[float], axes: tuple[float, float]) -> None:
    hands = Hands()
    hands.say(held=False)
    assert hands.say(held=True, axes=axes) == STAND
    assert hands.say(held=True, axes=(-7.0, 7.0)) == Wish(1.0, -1.0)


def test_a_gamepad_without_the_button_is_named(now: list[float]) -> None:
    hands = Hands()
    assert hands.say(held=True, buttons=3) == STAND
    assert "it has 3 buttons and 2 axes, without button 4 or axes 1, 0" in str(hands.gamepad)


def test_a_message_that_is_cut_short_is_named(now: list[float]) -> None:
    hands = Hands()
    cut = {"data": base64.b64encode(b"\0\1").decode(), "publisher": "aa"}
    hands.listener.waiting.append(cut)
    assert hands.gamepad.take() == STAND
    assert "unreadable messages on /joy" in str(hands.gamepad)
    assert hands.say(held=True) == STAND, "it said nothing of the button"


def test_a_second_gamepad_is_ignored_while_the_first_is_heard(now: list[float]) -> None:
    hands = Hands()
    hands.say(held=False)
    assert hands.say(held=True) == Wish(1.0, 0.5)
    assert hands.say(held=True, axes=(-1.0, -1.0), by="bb") is None
    assert "a second node publishes on /joy: it is ignored" in str(hands.gamepad)
    now[0] += 0.2
    assert hands.say(held=True, by="bb") == STAND, "its button must be released first"
    assert hands.say(held=False, by="bb") == STAND
    assert hands.say(held=True, by="bb") == Wish(1.0, 0.5)
