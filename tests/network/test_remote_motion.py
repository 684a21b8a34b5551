"""Between two hosts: motion is refused to the other one, a stop never."""

from __future__ import annotations

from contextlib import ExitStack

import pytest

from robotctl.kernel.modes import Mode
from tests.support.network import network, peer_on
from tests.support.waiting import until
from tests.support.world import new_world

STATIC = "ROS_STATIC_PEERS"
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"


@pytest.mark.parametrize("discovery", [pytest.param("SUBNET", marks=pytest.mark.slow), "LOCALHOST"])
def test_only_the_robots_own_computer_starts_motion_and_everybody_stops_it(discovery: str) -> None:
    """A daemon in LOCALHOST is reached by who names its host as a static peer."""
    with ExitStack() as stack:
        here, there = stack.enter_context(network(2))
        world = stack.enter_context(new_world())
        world.inside = here.inside
        world.environment[RANGE] = discovery
        world.ok("start", "--sim")
        elsewhere = {RANGE: "SUBNET", STATIC: here.address}
        remote = stack.enter_context(peer_on(there, world, **elsewhere))
        refused = remote("set_mode", mode=Mode.MOVING.value)
        assert not refused["success"]
        assert "was called from another host" in refused["message"]
        own = stack.enter_context(peer_on(here, world))
        until(lambda: own("set_mode", mode=Mode.MOVING.value)["success"])
        assert remote("set_mode", mode=Mode.IDLE.value)["success"]
        assert own("set_mode", mode=Mode.MOVING.value)["success"]
        assert remote("answer", number=remote("ask", service="estop"))["success"]
        assert world.status()["mode"] == "EMERGENCY_STOP"
        world.ok("stop")
