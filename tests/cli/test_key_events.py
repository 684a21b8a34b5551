"""Keys from the bytes of a terminal, and what the hands on them want."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotctl.cli.commands.teleop.held_keys import (
    STAND,
    STEERING,
    HandsWithoutReleases,
    HandsWithReleases,
    Wish,
)
from robotctl.cli.terminal.key_events import Key, KeyEvent, KeyParser

PRESSED, REPEATED, RELEASED = KeyEvent.PRESSED, KeyEvent.REPEATED, KeyEvent.RELEASED
FORWARD = STEERING["w"]


def keys(text: str) -> list[Key]:
    return list(KeyParser().feed(text))


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("w", Key("w")),
        ("W", Key("w")),
        ("\x1b[A", Key("up")),
        ("\x1bOD", Key("left")),
        ("\x1b[119u", Key("w")),
        ("\x1b[119;1:1u", Key("w")),
        ("\x1b[119;1:2u", Key("w", REPEATED)),
        ("\x1b[119;1:3u", Key("w", RELEASED)),
        ("\x1b[119;129:3u", Key("w", RELEASED)),  # with Num Lock
        ("\x1b[1;1:3B", Key("down", RELEASED)),
        ("\x1b[1;65:2C", Key("right", REPEATED)),  # with Caps Lock
        ("\x1b[61:43;2:1u", Key("=")),
        ("\x1b[99;5u", Key("c", with_control=True)),
        ("\x1b[122;5:3u", Key("z", RELEASED, with_control=True)),
    ],
)
def test_a_key_is_read_in_the_forms_of_xterm_and_kitty(text: str, key: Key) -> None:
    assert keys(text) == [key]


@pytest.mark.parametrize(
    "text", ["\x1b[?0u", "\x1b[?62;4c", "\x1b[57441;2u", "\x1b[3~", "\x1b[u", "\x1b[200~"]
)
def test_answers_of_the_terminal_and_other_keys_are_no_keys(text: str) -> None:
    assert keys(text) == []


def test_a_sequence_may_come_in_parts() -> None:
    parser = KeyParser()
    got = [key for part in "a\x1b[119;1:3ub" for key in parser.feed(part)]
    assert got == [Key("a"), Key("w", RELEASED), Key("b")]


@given(st.lists(st.text(st.sampled_from("\x1b[O?;:0123456789uAcw~ \x00"), max_size=60)))
def test_no_text_of_a_terminal_is_too_odd(parts: list[str]) -> None:
    parser = KeyParser()
    for part in parts:
        list(parser.feed(part))
    assert [key.name for key in parser.feed("0~w")][-1:] == ["w"]


def test_a_key_with_releases_is_held_until_its_release() -> None:
    hands = HandsWithReleases()
    assert hands.take([], 0.0) == STAND
    assert hands.take(keys("\x1b[119;1:1u"), 0.0) == FORWARD
    assert hands.take([], 100.0) == FORWARD
    assert hands.take(keys("\x1b[97;1:1u"), 100.0) == Wish(1.0, 1.0)
    assert hands.take(keys("\x1b[1;1:1A"), 100.0) == Wish(1.0, 1.0), "never more than all"
    assert hands.take(keys("\x1b[119;1:3u\x1b[1;1:3A"), 100.0) == Wish(0.0, 1.0)
    assert hands.take(keys("\x1b[97;1:3u"), 100.0) == STAND


def test_a_forgotten_key_with_releases_must_be_pressed_again() -> None:
    hands = HandsWithReleases()
    hands.take(keys("\x1b[119;1:1u"), 0.0)
    hands.forget()
    assert hands.take(keys("\x1b[119;1:2u"), 0.0) == STAND
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


def test_a_forgotten_key_without_releases_must_rest_first() -> None:
    hands = HandsWithoutReleases()
    for n in range(4):
        hands.take(keys("w"), n * 0.033)
    hands.forget()
    assert [hands.take(keys("w"), 0.132 + n * 0.033) for n in range(9)] == [None] * 9
    assert hands.take(keys("w"), 2.0) is None
    assert hands.take(keys("w"), 2.033) == FORWARD
