"""One process a role, with a base that takes TwistStamped."""

from __future__ import annotations

import pytest

from robotctl.cdr.motion import frame_id_of
from robotctl.recording import Recording
from tests.support.arrangement import PATIENT_GATE, PATIENT_OWNER, Arrangement
from tests.support.waiting import until
from tests.support.world import World


@pytest.mark.parametrize(
    "stamped",
    [(), pytest.param(("-p", "command.stamped:=true"), marks=pytest.mark.slow)],
)
def test_the_gate_passes_twist_stamped_on_to_a_base_that_takes_it(
    world: World, stamped: tuple[str, ...]
) -> None:
    settings = world.folder / "base.yaml"
    settings.write_text("command: {stamped: true, frame_id: base_footprint}\n")
    roles = Arrangement(world)
    roles.sim("--config", str(settings))
    roles.gate(*PATIENT_GATE)
    roles.owner(*PATIENT_OWNER, *stamped, "-p", "command.frame_id:=base_footprint")
    roles.until_complete()
    until(lambda: roles.status()["velocity"]["linear"] > 0.05)
    world.ok("set-mode", "idle")
    world.ok("stop")
    roles.end()
    assert "passing on geometry_msgs/msg/TwistStamped" in world.role_log("velocity_publisher")
    (report,) = world.answer("replay", "last", "--check")["recordings"]
    assert (report["verdict"], report["commands"] > 0) == ("same", True)
    topics = {each["name"]: each for each in world.answer("info", "last")["topics"]}
    for name in ("/cmd_vel", "/cmd_vel/owner"):
        assert topics[name]["type"] == "geometry_msgs/msg/TwistStamped"
        assert topics[name]["count"] > 0
    (file,) = (world.folder / "recordings").glob("*/*.mcap")
    with Recording(file) as recording:
        passed = [
            each for each in recording.messages({"/cmd_vel"}, pytest.fail) if any(each.data[-48:])
        ]
    assert {frame_id_of(each.data) for each in passed} == {"base_footprint"}
