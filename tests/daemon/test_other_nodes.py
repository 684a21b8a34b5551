"""Other nodes in the ROS domain: an existing robot, another publisher of commands."""

from __future__ import annotations

import os
import re
import signal
import time

from tests.support.lines import line_of
from tests.support.waiting import DEADLINE_S, until
from tests.support.world import PATIENT, NewPeer, World


def test_where_a_robot_is_none_is_simulated_unless_asked(world: World, new_peer: NewPeer) -> None:
    peer = new_peer(world)
    peer("be_a_robot")
    peer("take_commands", kind="Twist")
    out = world.ok("start")
    assert "simulator   no" in out
    assert "note: no simulator: /odom has a publisher already" in out
    assert "/simulated_robot" not in peer("nodes")
    status = world.status()
    assert status["sim"] is False
    assert status["pose"] == {"x": 0.0, "y": 0.0, "theta": 0.0}
    assert status["battery"] == 1.0
    # the existing robot is driven
    until(lambda: world.here("set-mode", "moving").out == "Mode changed to MOVING\n")
    world.ok("stop")
    assert "simulator   yes" in world.ok("start", "--sim")
    until(lambda: "/simulated_robot" in peer("nodes"))
    world.ok("stop")


def test_a_robot_outside_stops_by_itself_while_its_daemon_is_suspended_and_when_it_is_killed(
    world: World, new_peer: NewPeer
) -> None:
    world.patient.write_text(PATIENT.replace("max_tick_gap_s: 5.0", "max_tick_gap_s: 1.5"))
    peer = new_peer(world)
    peer("listen")
    robot = world.spawn("sim")
    assert "simulated robot robot runs in ROS domain" in line_of(robot.stdout)
    assert "simulator   no" in world.ok("start")

    def drive() -> None:
        until(lambda: world.here("reset").exit_code == 0)
        world.ok("set-mode", "moving")
        # The peer discovers robot and daemon at different times.
        until(lambda: peer("heard")["commands"] and peer("heard")["commands"][-1][2] > 0.1)
        until(lambda: peer("heard")["speed"] > 0.1)

    drive()
    pid = int(world.status()["pid"])
    suspended = time.monotonic()
    os.kill(pid, signal.SIGSTOP)
    until(lambda: abs(peer("heard")["speed"]) < 0.01 and time.monotonic() - suspended > 2.0)
    os.kill(pid, signal.SIGCONT)
    until(lambda: world.status()["mode"] == "ERROR")
    assert re.search("no control tick|loop stalled", world.status()["mode_reason"])
    heard = len(peer("heard")["commands"])
    until(lambda: len(peer("heard")["commands"]) > heard + 20)
    assert all(command[2] == 0.0 for command in peer("heard")["commands"][heard:])
    drive()
    world.kill(pid)
    until(lambda: abs(peer("heard")["speed"]) < 0.01)
    assert peer("heard")["commands"][-1][2] > 0.1  # without a new request
    robot.send_signal(signal.SIGINT)
    assert robot.wait(DEADLINE_S) == 0
    robot.communicate()
    (world.folder / "run" / "robotctl" / "robot.sock").unlink()  # as the next start would
