"""One process a role is an arrangement like the daemon: it drives, records, and ends in zeros."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Verdict
from tests.support.arrangement import PATIENT_GATE, PATIENT_OWNER, Arrangement
from tests.support.waiting import until
from tests.support.world import Peer, World, read_back

NewPeer = Callable[[World], Peer]


@pytest.fixture
def robot(world: World) -> Iterator[Arrangement]:
    """The processes of one robot, none started yet; what still runs ends with the test."""
    made = Arrangement(world)
    yield made
    made.end()


def last_commands(peer: Peer) -> list[list[float]]:
    """The last five commands of the robot that the peer has heard."""
    return [list(each[2:]) for each in peer("heard")["commands"][-5:]]


def until_zeros(peer: Peer) -> None:
    """Wait until the robot hears zeros only, and stands."""
    heard = len(peer("heard")["commands"])
    until(
        lambda: (
            len(peer("heard")["commands"]) > heard + 5 and not any(map(any, last_commands(peer)))
        )
    )
    until_it_stands(peer)


def until_it_stands(peer: Peer) -> None:
    until(lambda: abs(peer("heard")["speed"]) < 0.02)


def until_it_moves(robot: Arrangement, peer: Peer) -> None:
    """Wait until the robot moves; what refuses it at first is asked again."""

    def moves() -> bool:
        if robot.status()["mode"] != "MOVING":
            robot.set_mode("idle")
            robot.set_mode("moving")
        return bool(peer("heard")["speed"] > 0.05)

    until(moves)


def test_a_square_is_driven_and_recorded_and_ctrl_c_ends_it_with_a_zero(
    robot: Arrangement, world: World, new_peer: NewPeer
) -> None:
    robot.start()
    peer = new_peer(world)
    peer("listen")
    assert robot.set_mode("idle")
    drive = world.answer("drive", "square", "--side", "0.4", "--wait")
    assert drive["laps"] == 1
    assert drive["cross_track_max_m"] < 0.4
    until_it_moves(robot, peer)
    assert set(robot.end()) == {0}
    until(lambda: not any(last_commands(peer)[-1]))
    for name in ("mode_service", "velocity_publisher"):
        assert "Shutting down ..." in world.role_log(name)
        assert "Traceback" not in world.role_log(name)
    (recording,) = world.recordings.iterdir()
    assert check_recording(recording).verdict is Verdict.SAME
    topics = read_back(recording)
    assert {"/cmd_vel", "/cmd_vel/owner", "/odom", "/robotctl/journal"} <= set(topics)


def test_a_robot_and_a_gate_that_are_killed_end_in_zeros_and_revive_no_motion(
    robot: Arrangement, world: World, new_peer: NewPeer
) -> None:
    sim, gate = robot.sim(), robot.gate(*PATIENT_GATE)
    robot.owner(*PATIENT_OWNER, "-p", "odometry.timeout_s:=2.0")
    robot.until_complete()
    peer = new_peer(world)
    peer("listen")
    until_it_moves(robot, peer)
    world.kill(sim.pid)
    until(lambda: robot.status()["mode"] == "ERROR")
    until(lambda: not any(map(any, last_commands(peer))))
    robot.sim()
    until_it_moves(robot, peer)
    world.kill(gate.pid)
    robot.gate(*PATIENT_GATE)  # as `respawn` of a launch file does
    until(lambda: robot.status()["mode"] == "ERROR")
    until_zeros(peer)


def test_an_owner_that_is_killed_ends_in_zeros_and_the_next_one_moves_nothing(
    robot: Arrangement, world: World, new_peer: NewPeer
) -> None:
    robot.sim()
    robot.gate()
    owner = robot.owner(*PATIENT_OWNER)
    robot.until_complete()
    peer = new_peer(world)
    peer("listen")
    until_it_moves(robot, peer)
    world.kill(owner.pid)
    until_zeros(peer)
    robot.owner(*PATIENT_OWNER)
    until(lambda: world.here("status").exit_code == 0)
    assert robot.status()["mode"] == "IDLE"
    until_zeros(peer)
    assert "the owner of the mode is silent: publishing zeros" in world.role_log(
        "velocity_publisher"
    )


def test_a_silent_publisher_is_noticed_after_a_second_gate_has_left(
    robot: Arrangement, world: World, new_peer: NewPeer
) -> None:
    robot.start()
    assert robot.set_mode("idle")
    second = robot.gate(*PATIENT_GATE)
    until(lambda: "2 gates" in str(robot.status()["warnings"]))
    second.terminate()
    assert second.wait(timeout=60) == 0
    robot.until_complete()
    assert robot.set_mode("idle")
    new_peer(world)("publish", kind="Twist", topic="/cmd_vel")
    until(lambda: "/somebody_else" in str(robot.status()["warnings"]))
    refused = world.robotctl("set-mode", "moving")
    assert refused.exit_code == 4
    assert "/somebody_else also publishes velocity commands" in refused.err
    closed = "/somebody_else publishes /cmd_vel too: publishing zeros"
    until(lambda: closed in world.role_log("velocity_publisher"))


def test_a_remapped_command_topic_is_that_of_gate_and_owner(
    robot: Arrangement, world: World
) -> None:
    remap = ("-r", "cmd_vel:=/base/cmd_vel")
    robot.gate(*remap, *PATIENT_GATE)
    robot.owner(*remap, *PATIENT_OWNER)
    missing = "behind the gate nothing takes /base/cmd_vel"
    until(lambda: missing in world.here("set-mode", "moving").err)


def test_standalone_moves_until_a_gate_joins(robot: Arrangement, world: World) -> None:
    robot.owner()
    until(lambda: robot.set_mode("moving"))
    assert robot.status()["mode"] == "MOVING"
    assert "these start conditions are off" in str(robot.status()["warnings"])
    robot.gate()
    until(lambda: robot.status()["mode"] == "IDLE")  # whichever of its parts was found first
    missing = "behind the gate nothing takes /cmd_vel"
    until(lambda: missing in world.here("set-mode", "moving").err)


@pytest.mark.slow  # six processes; two services in namespaces: tests/executables
def test_two_robots_in_namespaces_do_not_hear_each_other(world: World, new_peer: NewPeer) -> None:
    robots = [Arrangement(world, name) for name in ("r1", "r2")]
    try:
        for robot in robots:
            robot.start()
            assert robot.set_mode("idle")
        peer = new_peer(world)
        peer("listen", namespace="/r2")
        other = new_peer(world)
        other("listen", namespace="/r1")
        until(lambda: len(peer("heard")["commands"]) > 5)
        until_it_moves(robots[0], other)
        assert robots[0].set_mode("idle")
        assert {tuple(each[2:]) for each in peer("heard")["commands"]} == {(0.0, 0.0)}
        assert {each[2] for each in peer("heard")["statuses"]} <= {"r2"}
        assert robots[1].status()["mode"] == "IDLE"
    finally:
        for robot in robots:
            robot.end()
