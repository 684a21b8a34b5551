"""Keys from the bytes of a terminal, and what the hands on them want."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotctl.cli.commands.teleop.controls import (
    MAX_AT_ONCE,
    STAND,
    STEERING,
    HandsWithoutReleases,
    HandsWithReleases,
    Wish,
    typed,
)
from robotctl.cli.ui.keys import ANSWER, MAX_STRING, Key, KeyEvent, KeyParser

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
        "\x1b[?62;4c",
        "\x1b[57441;2u",
        "\x1b[3~",
        "\x1b[u",
        "\x1b]52;c;abcwasd\x07",
        "\x1b]11;rgb:ffff/0000/dddd\x1b\\",
        "\x1bP>|a terminal we saw\x1b\\",
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


def test_keys_that_waited_are_no_repeats() -> None:
    hands = HandsWithoutReleases()
    assert hands.take(keys("wwwwwwww"), 1.0) is None


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
