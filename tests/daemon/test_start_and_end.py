"""Starting twice, starting wrong, ending by every means: nothing half-done is left."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from robotctl.kernel.types import ModeChanged
from robotctl.replay.rerun import rerun
from robotctl.testing.waiting import DEADLINE_S, until
from robotctl.testing.world import ROBOTCTL, Peer, World, journal_of, read_back


def pid_of(world: World, robot: str = "robot") -> int:
    return int(world.status(robot)["pid"])


def is_drivable(world: World) -> bool:
    status = world.status()
    return status["pose"] is not None and status["battery"] is not None


def last_command(folder: Path) -> bytes:
    """The velocities of the last recorded command, as serialized."""
    return bytes(read_back(folder)["/cmd_vel"][-1].data[4:])


STILL = bytes(48)
LIMITED = ("prlimit", "--fsize=60000", ROBOTCTL)


# Starting twice


def test_a_second_start_names_the_running_pid(world: World) -> None:
    world.ok("start", "--sim")
    pid = pid_of(world)
    second = world.robotctl("start", "--sim")
    assert (second.exit_code, second.out) == (5, "")
    assert f"robot 'robot' is running already, pid {pid}" in second.err
    assert len(list(world.recordings.iterdir())) == 1
    world.ok("stop")


def test_of_ten_starts_at_once_one_wins_and_the_others_name_it(world: World) -> None:
    race(world)


@pytest.mark.slow
def test_fifty_races_have_one_winner_each(world: World) -> None:
    for _ in range(50):
        race(world)


def race(world: World) -> None:
    recorded = len(list(world.recordings.glob("*")))
    starts = [world.spawn("start", "--sim") for _ in range(10)]
    ended = [(*process.communicate(), process.returncode) for process in starts]
    pid = pid_of(world)
    assert sorted(exit_code for *_, exit_code in ended) == [0] + 9 * [5]
    assert all(f"pid {pid}" in err for _, err, exit_code in ended if exit_code == 5)
    assert len(list(world.recordings.iterdir())) == recorded + 1
    world.ok("stop")


def test_two_robots_live_side_by_side(world: World, new_peer: Callable[[World], Peer]) -> None:
    peer = new_peer(world)
    for robot in ("left", "right"):
        world.ok("start", "--sim", "--robot", robot)
    nodes = peer("nodes")
    until(lambda: len(peer("nodes")) >= 14)
    nodes = peer("nodes")
    for robot in ("left", "right"):
        for node in ("velocity_publisher", "odom_subscriber", "mode_service", "simulated_robot"):
            assert f"/{robot}/{node}" in nodes
    answer = peer("set_mode", mode=3, namespace="/left")
    assert answer["success"] is True
    assert world.status("left")["mode"] == "EMERGENCY_STOP"
    assert world.status("right")["mode"] == "IDLE"
    assert {topic["name"] for topic in world.status("right")["topics"]} >= {"/right/cmd_vel"}
    for robot in ("left", "right"):
        world.ok("stop", "--robot", robot)


def test_a_start_in_a_shell_with_another_ros_drops_it_and_says_so(world: World) -> None:
    world.source_another_ros()
    out = world.ok("start", "--sim")
    assert "note: dropped another ROS (humble) from PYTHONPATH, LD_LIBRARY_PATH, AMENT" in out
    world.ok("stop")


# Starting wrong


def test_a_wrong_configuration_starts_nothing(world: World) -> None:
    config = world.folder / "robot.yaml"
    config.write_text("limits.linear_mps: -1")
    ran = world.robotctl("start", "--config", str(config))
    assert (ran.exit_code, ran.out) == (2, "")
    assert f"{config}: limits.linear_mps: -1 is not allowed: use 0.01 to 10 m/s" in ran.err
    assert ran.err.count("\n") == 1
    assert not world.recordings.exists()


def test_a_socket_path_that_is_too_long_starts_nothing(world: World) -> None:
    world.environment["XDG_RUNTIME_DIR"] = str(world.folder / "run" / ("long" * 25))
    ran = world.robotctl("start", "--sim")
    assert ran.exit_code == 2
    assert "longer than 107 bytes: set XDG_RUNTIME_DIR to a shorter folder" in ran.err
    assert not world.recordings.exists()


def test_something_else_in_the_place_of_the_socket_starts_nothing(world: World) -> None:
    (world.folder / "run" / "robotctl").mkdir(mode=0o700)
    in_the_way = world.folder / "run" / "robotctl" / "robot.sock"
    in_the_way.write_text("mine")
    ran = world.robotctl("start", "--sim")
    assert ran.exit_code == 2
    assert f"{in_the_way} is not a socket" in ran.err
    assert list(world.recordings.iterdir()) == []
    assert in_the_way.read_text() == "mine"
    in_the_way.unlink()


def test_a_file_in_the_place_of_the_runtime_folder_is_named(world: World) -> None:
    in_the_way = world.folder / "run" / "robotctl"
    in_the_way.write_text("")
    ran = world.robotctl("start", "--sim")
    assert ran.exit_code != 0
    assert str(in_the_way) in ran.err
    assert ran.err.count("\n") == 1


def test_a_file_in_the_place_of_the_recordings_folder_is_named(world: World) -> None:
    world.recordings.write_text("mine")
    ran = world.robotctl("start", "--sim")
    assert ran.exit_code == 4
    assert f"cannot record into {world.recordings}" in ran.err
    assert "--recordings" in ran.err
    assert world.recordings.read_text() == "mine"


def test_a_ros_domain_that_does_not_exist_starts_nothing(world: World) -> None:
    world.environment["ROS_DOMAIN_ID"] = "233"
    ran = world.robotctl("start", "--sim")
    assert ran.exit_code == 2
    assert "ROS_DOMAIN_ID is '233': use 0 to 232" in ran.err
    assert not world.recordings.exists()


def test_a_failed_start_in_the_foreground_says_why_in_one_line(world: World) -> None:
    world.recordings.write_text("")
    ran = world.robotctl("start", "--foreground", "--sim")
    assert (ran.exit_code, ran.out) == (4, "")
    assert ran.err.startswith("robotctl: cannot record into ")
    assert ran.err.count("\n") == 1


# Without a robot


def test_moving_without_odometry_is_refused_with_the_cure(world: World) -> None:
    world.ok("start", "--no-sim")
    status = world.status()
    assert (status["sim"], status["pose"], status["battery"]) == (False, None, None)
    refused = world.robotctl("set-mode", "moving")
    assert (refused.exit_code, refused.out) == (4, "")
    assert "no odometry was received on odom yet" in refused.err
    assert "check that the robot publishes odometry" in refused.err
    assert world.status()["mode"] == "IDLE"
    world.ok("stop")


def test_a_drive_at_the_start_that_is_refused_says_so(world: World) -> None:
    out = world.ok("start", "--no-sim", "--drive", "square")
    assert "no odometry was received on odom yet" in out
    assert world.status()["mode"] == "IDLE"
    world.ok("stop")


def test_start_with_drive_moves_at_once(world: World) -> None:
    out = world.ok("start", "--sim", "--drive", "circle")
    assert "mode        MOVING" in out
    assert world.status()["mode"] == "MOVING"
    world.ok("stop")
    assert last_command(next(world.recordings.iterdir())) == STILL


# The emergency stop outlives the process


def test_an_emergency_stop_is_left_by_reset_only(world: World) -> None:
    latch = world.folder / "state" / "robotctl" / "robot" / "emergency-stop"
    world.ok("start", "--sim")
    assert "release it with: robotctl reset" in world.ok("estop")
    assert latch.exists()
    refused = world.robotctl("set-mode", "moving")
    assert refused.exit_code == 4
    assert "EMERGENCY_STOP" in refused.err
    assert "robotctl reset" in refused.err
    world.ok("stop")
    # after a stop
    assert "still latched from before" in world.ok("start", "--sim")
    assert world.status()["mode"] == "EMERGENCY_STOP"
    # after a kill
    world.kill(pid_of(world))
    world.ok("start", "--sim")
    assert world.status()["mode"] == "EMERGENCY_STOP"
    assert "requested by robotctl estop" in world.status()["mode_reason"]
    assert "released" in world.ok("reset")
    assert not latch.exists()
    world.ok("stop")
    assert "mode        IDLE" in world.ok("start", "--sim")
    world.ok("stop")


def test_a_latch_that_cannot_be_written_is_told_and_the_robot_stops_all_the_same(
    world: World,
) -> None:
    world.ok("start", "--sim")
    partial = world.folder / "state" / "robotctl" / "robot" / "emergency-stop.new"
    partial.mkdir()  # where the latch would be written first
    out = world.ok("estop")
    assert "Mode changed to EMERGENCY_STOP" in out
    assert "could not be saved" in out
    assert world.status()["mode"] == "EMERGENCY_STOP"
    world.ok("stop")


# Killed


def test_after_a_kill_the_next_start_cleans_up_and_repairs(world: World) -> None:
    world.ok("start", "--sim", "--drive", "circle")
    until(lambda: world.status()["recorder"]["written"] > 100)
    world.kill(pid_of(world))
    assert world.sockets() != []
    assert world.robotctl("status").exit_code == 3
    killed = next(world.recordings.iterdir())
    out = world.ok("start", "--sim")
    assert world.status()["mode"] == "IDLE"
    assert f"{killed.name}_0.mcap" in out  # what was repaired
    world.ok("stop")
    journal = journal_of(read_back(killed)["/robotctl/journal"])
    assert any(entry.name == ModeChanged.__name__ for entry in journal)
    assert rerun(journal) is None


@pytest.mark.slow
def test_fifty_kills_are_followed_by_fifty_starts(world: World) -> None:
    for _ in range(50):
        world.ok("start", "--sim", "--drive", "circle")
        world.kill(pid_of(world))
    world.ok("start", "--sim")
    world.ok("stop")
    for folder in world.recordings.iterdir():
        # Killed within its first 0.3 s, a recording is valid and empty.
        assert rerun(journal_of(read_back(folder).get("/robotctl/journal", []))) is None


# Ended by a signal


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_moving_ends_with_zero_and_a_closed_recording(
    world: World, number: signal.Signals
) -> None:
    world.ok("start", "--sim", "--drive", "circle")
    until(lambda: world.status()["velocity"]["linear"] > 0.05)
    pid = pid_of(world)
    os.kill(pid, number)
    until(lambda: pid not in world.processes())
    assert last_command(next(world.recordings.iterdir())) == STILL
    assert "0 dropped, 0 lost" in world.log()
    assert world.sockets() == []


def test_a_signal_during_the_start_ends_it(world: World) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as somebody:
        # Where somebody seems to be, a start listens for a robot that is there, for seconds.
        somebody.bind(("127.0.0.1", 7400 + 250 * world.domain_id + 249))
        start = world.spawn("start")
        until(lambda: world.recordings.exists() or start.poll() is not None)
        for pid, command in world.processes().items():
            if "robotctl.daemon" in command:
                os.kill(pid, signal.SIGTERM)
        _, err = start.communicate(timeout=DEADLINE_S)
    assert start.returncode != 0
    assert "told to stop before it was ready" in err
    until(lambda: not world.processes())


def test_the_daemon_runs_in_the_foreground(world: World) -> None:
    process = world.spawn("start", "--foreground", "--sim")
    assert process.stdout is not None
    ready = json.loads(process.stdout.readline())
    assert (ready["ready"], ready["pid"]) == (True, process.pid)
    assert pid_of(world) == process.pid
    process.send_signal(signal.SIGINT)
    assert process.wait(DEADLINE_S) == 0
    process.communicate()


def test_two_stops_at_once_both_succeed(world: World) -> None:
    world.ok("start", "--sim")
    stops = [world.spawn("stop") for _ in range(2)]
    for process in stops:
        _, err = process.communicate(timeout=DEADLINE_S)
        assert process.returncode in (0, 3), err
    assert world.robotctl("status").exit_code == 3
    assert world.robotctl("stop").exit_code == 3


# Clients that come and go


def test_a_client_that_hangs_up_changes_nothing_and_a_waiting_one_is_told_of_the_end(
    world: World,
) -> None:
    world.ok("start", "--sim")
    first = world.spawn("drive", "square", "--wait")
    until(lambda: world.status()["mode"] == "MOVING")
    first.kill()
    first.communicate()
    assert world.status()["mode"] == "MOVING"
    second = world.spawn("drive", "circle", "--wait", "--replace")
    until(lambda: "drive ended: replaced" in world.log())
    world.ok("stop")
    _, err = second.communicate(timeout=DEADLINE_S)
    assert second.returncode == 4
    assert "the drive ended after 0 laps: requested by the daemon's end" in err


def test_a_waited_drive_that_a_fault_ends_is_an_error(world: World) -> None:
    world.ok("start", "--sim")
    drive = world.spawn("drive", "square", "--wait")
    until(lambda: world.status()["mode"] == "MOVING")
    world.ok("estop")
    _, err = drive.communicate(timeout=DEADLINE_S)
    assert drive.returncode == 4
    assert "the drive ended after 0 laps: requested by robotctl estop" in err
    world.ok("stop")


def test_why_is_told_while_the_daemon_runs_and_the_recording_proves_it(world: World) -> None:
    world.ok("start", "--sim")
    world.ok("drive", "square")
    until(lambda: world.status()["velocity"]["linear"] > 0.05)
    world.ok("estop")
    until(lambda: world.robotctl("why").exit_code == 0)  # the file shows it a moment later
    told = world.answer("why")
    assert (told["kind"], told["mode"]) == ("stop", "EMERGENCY_STOP")
    assert "a request for EMERGENCY_STOP by robotctl estop" in told["came_in"]
    assert "a square: robotctl drive" in told["asked"]
    assert told["zero_after_ms"] >= 0.0
    world.ok("stop")
    (report,) = world.answer("replay", "last", "--check")["recordings"]
    assert (report["verdict"], report["notes"]) == ("same", [])
    assert report["commands"] > 0


def test_a_drive_while_moving_is_refused_unless_it_replaces(world: World) -> None:
    world.ok("start", "--sim", "--drive", "circle")
    refused = world.robotctl("drive", "square")
    assert refused.exit_code == 4
    assert "--replace" in refused.err
    world.ok("drive", "square", "--replace")
    assert world.status()["mode"] == "MOVING"
    world.ok("stop")


# The recorder fails


def test_a_recorder_that_fails_stops_the_robot(world: World) -> None:
    limited = subprocess.run(
        [*LIMITED, "start", "--sim", "--drive", "circle", "--config", str(world.patient)],
        cwd=world.folder,
        env=world.environment,
        capture_output=True,
        text=True,
    )
    assert limited.returncode == 0, limited.stderr
    until(lambda: world.status()["mode"] == "ERROR")
    status = world.status()
    assert status["recorder"]["state"] == "failed"
    assert "File too large" in status["mode_reason"]
    refused = world.robotctl("reset")
    assert refused.exit_code == 4
    recorder = world.status()["recorder"]
    assert recorder["received"] == recorder["written"] + recorder["queued"] + recorder["dropped"]
    world.ok("stop")
    journal = journal_of(read_back(next(world.recordings.iterdir()))["/robotctl/journal"])
    assert rerun(journal) is None
