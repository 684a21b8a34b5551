"""Other nodes in the ROS domain: an existing robot, another publisher of commands."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import time

from tests.support.waiting import DEADLINE_S, until
from tests.support.world import PATIENT, NewPeer, Peer, World


def test_no_robot_is_simulated_where_one_is_unless_it_is_asked_for(
    world: World, new_peer: NewPeer
) -> None:
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
    until(lambda: world.robotctl("set-mode", "moving").out == "Mode changed to MOVING\n")
    world.ok("stop")
    assert "simulator   yes" in world.ok("start", "--sim")
    until(lambda: "/simulated_robot" in peer("nodes"))
    world.ok("stop")


def drive_a_robot_outside(world: World, peer: Peer) -> subprocess.Popen[str]:
    """Start a robot and a daemon as separate processes, and wait until the robot drives."""
    peer("listen")
    robot = world.spawn("sim")
    assert robot.stdout is not None
    assert "simulated robot robot runs in ROS domain" in robot.stdout.readline()
    assert "simulator   no" in world.ok("start")
    world.ok("set-mode", "moving")
    # The peer discovers robot and daemon at different times.
    until(lambda: any(command[2] > 0.1 for command in peer("heard")["commands"]))
    until(lambda: peer("heard")["speed"] > 0.1)
    return robot


def end(robot: subprocess.Popen[str]) -> None:
    robot.send_signal(signal.SIGINT)
    assert robot.wait(DEADLINE_S) == 0
    robot.communicate()


def test_a_robot_outside_stops_by_itself_when_the_daemon_is_killed(
    world: World, new_peer: NewPeer
) -> None:
    peer = new_peer(world)
    robot = drive_a_robot_outside(world, peer)
    world.kill(int(world.status()["pid"]))
    until(lambda: abs(peer("heard")["speed"]) < 0.01)
    assert peer("heard")["commands"][-1][2] > 0.1  # without a new request
    end(robot)
    (world.folder / "run" / "robotctl" / "robot.sock").unlink()  # as the next start would


def test_a_robot_outside_stops_by_itself_while_the_daemon_is_suspended_and_by_it_afterwards(
    world: World, new_peer: NewPeer
) -> None:
    world.patient.write_text(PATIENT.replace("max_tick_gap_s: 5.0", "max_tick_gap_s: 1.5"))
    peer = new_peer(world)
    robot = drive_a_robot_outside(world, peer)
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
    world.ok("stop")
    end(robot)
