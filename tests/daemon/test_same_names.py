"""Two daemons with the same node names in one domain are named, and refused unless asked for."""

from __future__ import annotations

from tests.support.world import new_world


def test_a_second_daemon_with_the_same_names_is_refused_and_disturbs_nobody() -> None:
    with new_world() as world, new_world() as other:
        other.environment["ROS_DOMAIN_ID"] = world.environment["ROS_DOMAIN_ID"]
        world.may_lack = other.may_lack = "two daemons publish the same statuses"
        world.ok("start", "--sim", "--drive", "circle")
        ran = other.robotctl("start", "--sim")
        assert ran.exit_code == 4, ran
        assert "has the same nodes: /velocity_publisher, /odom_subscriber" in ran.err
        assert "--robot NAME" in ran.err
        assert world.status()["mode"] == "MOVING"
        other.ok("start", "--sim", "--robot", "r2")
        other.ok("stop", "--robot", "r2")
        other.ok("start", "--no-sim", "--allow-same-names")
        other.ok("stop")
        world.ok("stop")
