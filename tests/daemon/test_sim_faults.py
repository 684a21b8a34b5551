"""A daemon whose simulated robot fails stops it, and says when and why."""

from __future__ import annotations

import json

from tests.support.world import World


def test_a_fault_of_the_simulated_robot_stops_it_and_is_marked_in_the_recording(
    world: World,
) -> None:
    world.ok("start", "--sim", "--drive", "circle")
    told = world.answer("sim", "fault", "brownout", "--for", "1s")
    assert told["mode"] == "EMERGENCY_STOP"
    assert told["stopped_after_ms"] > 0.0
    assert "the battery is at 10%" in told["message"]
    assert "did not move" in world.ok("sim", "fault", "slip", "--for", "100ms")
    world.ok("sim", "set", "battery=0.5")
    wrong = world.robotctl("sim", "fault", "slip", "--for", "2h", "--json")
    assert (wrong.exit_code, json.loads(wrong.out)["error"]["kind"]) == (2, "usage")
    assert world.robotctl("sim", "set", "battery=2").exit_code == 2
    world.ok("stop")
    events = world.answer("info", "last")["events"]
    marks = [each["text"] for each in events if each["kind"] == "mark"]
    assert marks[0].startswith("simulated fault: brownout for 1 s")
