"""A timeline says which value was right at a time, and which change was never shown."""

from __future__ import annotations

from robotctl.rerun.values_over_time import EDGE_NS, Timeline

STEP = 10 * EDGE_NS


def timeline() -> Timeline[str]:
    """Return a timeline from "idle" to "moving" in the step between STEP and 2 * STEP."""
    made = Timeline("idle")
    made.change("moving", (0, STEP, 2 * STEP))
    return made


def test_before_a_change_only_the_value_before_is_right() -> None:
    assert timeline().shows("idle", STEP - 2 * EDGE_NS)
    assert not timeline().shows("moving", STEP - 2 * EDGE_NS)


def test_where_the_step_of_a_change_begins_both_values_are_right() -> None:
    assert timeline().shows("idle", STEP)
    assert timeline().shows("moving", STEP)


def test_within_the_step_of_a_change_only_the_new_value_is_right() -> None:
    assert timeline().shows("moving", STEP + 2 * EDGE_NS)
    assert not timeline().shows("idle", STEP + 2 * EDGE_NS)


def test_each_value_of_a_step_with_two_changes_is_right() -> None:
    made = timeline()
    made.change("error", (0, STEP, 2 * STEP))
    for value, is_right in (("idle", False), ("moving", True), ("error", True)):
        assert made.shows(value, STEP + 2 * EDGE_NS) is is_right


def test_after_a_change_only_the_new_value_is_right() -> None:
    made = timeline()
    (change,) = made.forget(4 * STEP)
    assert not change.is_shown
    assert made.shows("moving", 4 * STEP)
    assert not made.shows("idle", 4 * STEP)


def test_a_change_that_was_shown_in_its_step_is_known() -> None:
    made = timeline()
    made.shows("moving", STEP + 1)
    assert [change.is_shown for change in made.forget(4 * STEP)] == [True]
