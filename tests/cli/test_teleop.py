"""teleop: keys and gamepads, what the hands on them want, the speeds and the screen."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator
from math import inf, nan
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from rich.live import Live

from robotctl.cli.commands.teleop import KEYS, WITH_RELEASES, WITHOUT_RELEASES, view_below
from robotctl.cli.commands.teleop_controls import (
    JOY,
    MAX_AT_ONCE,
    SILENT_S,
    STAND,
    STEERING,
    STEP,
    Controls,
    Gamepad,
    HandsWithoutReleases,
    HandsWithReleases,
    Speeds,
    Wish,
    typed,
)
from robotctl.cli.targets.ros_view import MessageListener
from robotctl.cli.ui.keys import ANSWER, MAX_STRING, Key, KeyEvent, KeyParser
from robotctl.ipc.answers import Status
from robotctl.ipc.client import Client
from robotctl.messages.definition import parse_definition
from robotctl.messages.values import encode

PRESSED, REPEATED, RELEASED = KeyEvent.PRESSED, KeyEvent.REPEATED, KeyEvent.RELEASED
FORWARD = STEERING["w"]
ANSWERED = "\x1b[?11u"
"""A sign of life of a terminal that tells releases."""


def keys(text: str) -> list[Key]:
    return list(KeyParser().feed(text, 0.0))


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("w", Key("w", is_text=True)),
        ("W", Key("w", is_text=True)),
        ("\x1b[A", Key("up")),  # so kitty tells a press, also where it tells releases
        ("\x1bOD", Key("left", is_text=True)),
        ("\x1b[119u", Key("w")),
        ("\x1b[119;1:1u", Key("w")),
        ("\x1b[119;1:2u", Key("w", REPEATED)),
        ("\x1b[119;1:3u", Key("w", RELEASED)),
        ("\x1b[119;129:3u", Key("w", RELEASED)),  # with Num Lock
        ("\x1b[1;1:3B", Key("down", RELEASED)),
        ("\x1b[1;65:2C", Key("right", REPEATED)),  # with Caps Lock
        ("\x1b[61:43;2:1u", Key("=")),
        ("\x1b[?11u", Key(ANSWER)),
        ("\x1b[99;5u", Key("c", with_control=True)),
        ("\x1b[122;5:3u", Key("z", RELEASED, with_control=True)),
    ],
)
def test_a_key_is_read_in_the_forms_of_xterm_and_kitty(text: str, key: Key) -> None:
    assert keys(text) == [key]


@pytest.mark.parametrize(
    "text",
    [
        *("\x1b[?62;4c", "\x1b[57441;2u", "\x1b[3~", "\x1b[u", "\x1b]52;c;abcwasd\x07"),
        *("\x1b]11;rgb:ffff/0000/dddd\x1b\\", "\x1bP>|a terminal we saw\x1b\\"),
        "\x1b[200~w a s d\x1b[119;1:1u e\x1b[201~",
    ],
)
def test_answers_of_the_terminal_pastes_and_other_keys_are_no_keys(text: str) -> None:
    assert keys(text) == []
    parser = KeyParser()
    assert [key for each in f"{text}q" for key in parser.feed(each, 0.0)] == keys("q")


def test_what_only_begins_like_a_string_of_the_terminal_swallows_no_stop() -> None:
    parser = KeyParser()
    assert list(parser.feed("\x1b]", 1.0)) == [], "Alt-], or an answer"
    assert " " in [key.name for key in parser.feed(" ", 1.5)]
    assert "e" in [key.name for key in KeyParser().feed("\x1b]" + "x" * MAX_STRING + "e", 1.0)]


def test_a_sequence_may_come_in_parts() -> None:
    parser = KeyParser()
    got = [key for part in "a\x1b[119;1:3ub" for key in parser.feed(part, 0.0)]
    assert got == [*keys("a"), Key("w", RELEASED), *keys("b")]


@given(st.lists(st.text(st.sampled_from("\x1b[O]?;:0123456789uAcw~ \x00\x07"), max_size=60)))
def test_no_text_of_a_terminal_is_too_odd(parts: list[str]) -> None:
    parser = KeyParser()
    for part in parts:
        list(parser.feed(part, 0.0))
    assert [key.name for key in parser.feed("0~\x07\x1b[201~w", 1.0)][-1:] == ["w"]


def test_a_key_with_releases_is_held_until_its_release() -> None:
    hands = HandsWithReleases()
    assert hands.take(keys("\x1b[119;1:1u"), 0.0) == FORWARD
    assert hands.take(keys(ANSWERED), 0.1) == FORWARD
    assert hands.take(keys("\x1b[97;1:1u"), 0.1) == Wish(1.0, 1.0)
    assert hands.take(keys("\x1b[1;1:1A" + ANSWERED), 0.1) == Wish(1.0, 1.0), "no more than all"
    assert hands.take(keys("\x1b[119;1:3u\x1b[1;1:3A"), 0.1) == Wish(0.0, 1.0)
    assert hands.take(keys("\x1b[97;1:3u"), 0.1) == STAND


def test_a_held_key_is_asked_for_again_only_when_the_terminal_answers() -> None:
    hands = HandsWithReleases()
    assert hands.take(keys("\x1b[119;1:1u"), 0.0) == FORWARD
    assert hands.take([], 0.1) is None, "the connection may be lost"
    assert hands.take(keys("\x1b[119;1:2u"), 0.2) is None
    assert hands.take(keys(ANSWERED), 0.2) == FORWARD


def held_at(seconds: float, *told: tuple[float, str]) -> bool:
    """Return whether something is held at that time, after what a living terminal told."""
    hands = HandsWithReleases()
    last: Wish | None = STAND
    waiting = list(told)
    for now_s in (n / 100 for n in range(round(seconds * 100) + 1)):
        text = "".join(text for at_s, text in waiting if at_s <= now_s)
        waiting = [each for each in waiting if each[0] > now_s]
        last = hands.take(keys(text + ANSWERED), now_s)
    assert (hands.problem == "") or last == STAND
    return last != STAND


def test_a_key_that_never_repeats_or_stops_repeating_is_let_go() -> None:
    press, repeat = "\x1b[119;1:1u", "\x1b[119;1:2u"
    slow = [(0.66 + n * 0.05, repeat) for n in range(200)]
    assert held_at(0.7, (0.0, press)), "the delay before the first repeat"
    assert not held_at(0.9, (0.0, press))
    assert held_at(10.0, (0.0, press), *slow)
    assert held_at(0.9, (0.0, press), *slow[:1])
    assert not held_at(1.0, (0.0, press), *slow[:1])


def test_a_key_stays_held_while_another_one_is_tapped_and_a_while_after() -> None:
    press, tap, release = "\x1b[119;1:1u", "\x1b[97;1:1u", "\x1b[97;1:3u"
    taps = [(1.0 + n * 2.5, tap) for n in range(4)] + [(1.1 + n * 2.5, release) for n in range(4)]
    repeats = [(0.5 + n * 0.03, "\x1b[119;1:2u") for n in range(17)]
    assert held_at(11.0, (0.0, press), *repeats, *taps)
    assert not held_at(12.0, (0.0, press), *repeats, *taps)
    assert held_at(3.0, (0.0, press), (0.3, "\x1b[43u"), (0.4, "\x1b[43;1:3u")), "of any name"


def test_text_holds_no_key_where_the_terminal_tells_releases() -> None:
    hands = HandsWithReleases()
    assert hands.take(keys("forward wasd\x1bOA" + ANSWERED), 0.0) == STAND
    assert hands.take(keys("\x1b[A"), 0.0) == FORWARD


def test_only_stops_are_taken_from_text_that_no_hand_typed() -> None:
    def names(text: str, *, tells_releases: bool) -> str:
        return "".join(key.name for key in typed(keys(text), tells_releases=tells_releases))

    assert names("+-w qe", tells_releases=True) == " qe"
    assert names("\x1b[43u", tells_releases=True) == "+"
    assert names("+-w qe", tells_releases=False) == "+-w qe"
    assert names("+" * MAX_AT_ONCE + "e", tells_releases=False) == "e"


def test_a_forgotten_key_with_releases_must_be_pressed_again() -> None:
    hands = HandsWithReleases()
    hands.take(keys("\x1b[119;1:1u"), 0.0)
    hands.forget()
    assert hands.take(keys("\x1b[119;1:2u" + ANSWERED), 0.0) == STAND
    assert hands.take(keys("\x1b[119;1:3u\x1b[119;1:1u"), 0.0) == FORWARD


def test_a_key_without_releases_moves_only_when_it_repeats() -> None:
    hands = HandsWithoutReleases()
    assert hands.take(keys("w"), 1.0) is None
    assert hands.take([], 1.4) is None
    assert hands.take(keys("w"), 1.5) is None, "after the delay of the terminal"
    assert hands.take(keys("w"), 1.533) == FORWARD
    assert hands.take([], 1.54) is None, "once for each repeat"
    assert hands.take(keys("w"), 1.566) == FORWARD
    assert hands.take(keys("a"), 1.6) is None
    assert hands.take(keys("a"), 1.633) == STEERING["a"]


@pytest.mark.parametrize("text", ["w" * 20_000, "w" * 65, "forward " * 100, "x" * 130 + "ww"])
def test_what_is_pasted_moves_nothing_where_the_terminal_tells_no_releases(text: str) -> None:
    hands = HandsWithoutReleases()
    pieces = [text[at : at + 64] for at in range(0, len(text), 64)]
    wishes = [hands.take(keys(piece), n * 0.001) for n, piece in enumerate([*pieces, "w"])]
    assert wishes == [None] * len(wishes)
    hands.take(keys("w"), 100.0)
    assert hands.take(keys("w"), 100.03) == FORWARD


def test_a_forgotten_key_without_releases_must_rest_first() -> None:
    hands = HandsWithoutReleases()
    for n in range(4):
        hands.take(keys("w"), n * 0.033)
    hands.forget()
    assert [hands.take(keys("w"), 0.132 + n * 0.033) for n in range(9)] == [None] * 9
    assert hands.take(keys("w"), 2.0) is None
    assert hands.take(keys("w"), 2.033) == FORWARD


REFUSED = (
    "a refusal that says in more than one line of the terminal why the robot does not move: " * 2
)
TOPICS = [{"name": f"/topic{n}", "count": n, "rate": 1.0} for n in range(9)]
STATUS: dict[str, Any] = {
    "robot": "robot",
    "mode": "IDLE",
    "pose": None,
    "velocity": None,
    "battery": None,
    "recorder": {"state": "recording", "bytes": 1, "written": 1, "dropped": 0, "lost": 0},
    "topics": TOPICS,
    "warnings": ["the disk is nearly full"] * 2,
}


@pytest.mark.parametrize("instructions", [WITH_RELEASES, WITHOUT_RELEASES])
@pytest.mark.parametrize(("columns", "rows"), [(80, 24), (80, 20), (80, 16), (80, 12), (40, 14)])
def test_the_instructions_and_refusals_are_seen_whole(
    columns: int, rows: int, instructions: tuple[str, ...]
) -> None:
    console = Console(width=columns, height=rows, file=io.StringIO(), force_terminal=True)
    lines = [*instructions, KEYS, "speed 0.30 m/s", REFUSED]
    with Live(console=console, auto_refresh=False) as live, console.capture() as drawn:
        live.update(view_below(lines, cast("Status", STATUS)), refresh=True)
    seen = " ".join(drawn.get().split())
    for line in lines:
        assert " ".join(line.split()) in seen
    assert max(map(len, instructions)) <= 80


LIMITS = {"limits.linear_mps": 0.6, "limits.angular_rps": 1.5}


class Daemon:
    """A daemon with these limits."""

    def call(self, method: object) -> dict[str, Any]:
        return {"parameters": [{"key": key, "value": value} for key, value in LIMITS.items()]}


def speeds(speed_mps: float | None) -> Speeds:
    return Speeds(cast("Client", Daemon()), speed_mps)


@pytest.mark.parametrize("asked", [0.01, 0.02, 0.3, 0.6])
def test_the_speed_that_is_asked_for_is_driven(asked: float) -> None:
    linear_mps, angular_rps = speeds(asked).velocity(Wish(1.0, 1.0))
    assert linear_mps == pytest.approx(asked)
    assert angular_rps / 1.5 == pytest.approx(asked / 0.6)


def test_the_keys_scale_the_speeds_within_the_limits() -> None:
    chosen = speeds(None)
    assert str(chosen) == "0.30 m/s, 0.75 rad/s"
    for _ in range(100):
        chosen.scale(STEP)
    assert chosen.velocity(Wish(1.0, 1.0)) == (0.6, 1.5)
    for _ in range(100):
        chosen.scale(1.0 / STEP)
    assert chosen.velocity(Wish(1.0, 0.0))[0] == pytest.approx(0.01)


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
    monkeypatch.setattr("robotctl.cli.commands.teleop_controls.time.monotonic", lambda: moment[0])
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
