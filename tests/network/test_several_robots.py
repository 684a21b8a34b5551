"""Robots side by side, by namespace and by domain: none hears what is meant for another."""

from __future__ import annotations

from contextlib import ExitStack, closing

import pytest

from robotctl.domains import reserved_domain
from robotctl.kernel.modes import Mode
from tests.support.waiting import until
from tests.support.world import Peer, new_world


@pytest.mark.slow
def test_robots_of_two_namespaces_and_of_two_domains_do_not_disturb_each_other() -> None:
    with ExitStack() as stack:
        world = stack.enter_context(new_world())
        own_domain = str(stack.enter_context(reserved_domain()))
        world.ok("start", "--sim")
        world.ok("start", "--sim", "--robot", "r2")
        world.ok("start", "--sim", "--robot", "r3", "--namespace", "/", "--domain-id", own_domain)
        peer = stack.enter_context(closing(Peer(world)))

        def modes() -> list[str]:
            return [world.status(robot)["mode"] for robot in ("robot", "r2", "r3")]

        assert peer("set_mode", mode=Mode.MOVING.value)["success"]
        assert modes() == ["MOVING", "IDLE", "IDLE"]
        until(lambda: world.status()["pose"]["x"] > 0.2)
        assert [world.status(robot)["pose"]["x"] for robot in ("r2", "r3")] == [0.0, 0.0]
        assert peer("set_mode", mode=Mode.MOVING.value, namespace="/r2")["success"]
        world.ok("estop")
        assert modes() == ["EMERGENCY_STOP", "MOVING", "IDLE"]
        world.ok("drive", "circle", "--robot", "r3")
        assert peer("answer", number=peer("ask", service="estop", namespace="/r2"))["success"]
        assert modes() == ["EMERGENCY_STOP", "EMERGENCY_STOP", "MOVING"]
        for robot in ("robot", "r2", "r3"):
            assert [each for each in world.status(robot)["warnings"] if "publish" in each] == []
            world.ok("stop", "--robot", robot)
