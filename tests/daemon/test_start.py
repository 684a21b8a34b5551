"""A second start, a wrong start, a start without a robot: no partial state stays behind.
Starts with ROS arguments, a second daemon of the same names, a group for the socket.
"""

from __future__ import annotations

import grp
import os
import subprocess
import sys
from shutil import rmtree

import pytest

from robotctl.recording import read_info
from robotctl.recording.format.names import INFO_RECORD
from tests.support.lines import run_program
from tests.support.users import as_root, process_of
from tests.support.waiting import DEADLINE_S, until
from tests.support.world import ROBOTCTL, NewPeer, Peer, World, new_world

SLOW = pytest.mark.slow  # a daemon each; how descriptors are counted: tests/test_processes.py


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
    pid = world.status()["pid"]
    assert sorted(exit_code for *_, exit_code in ended) == [0] + 9 * [5]
    assert all(f"pid {pid}" in err for _, err, exit_code in ended if exit_code == 5)
    assert len(list(world.recordings.iterdir())) == recorded + 1
    world.ok("stop")


def test_two_robots_live_side_by_side(world: World, new_peer: NewPeer) -> None:
    peer = new_peer(world)
    for robot in ("left", "right"):
        world.ok("start", "--sim", "--robot", robot)
    until(lambda: len(peer("nodes")) >= 10)
    names = ("velocity_publisher", "odom_subscriber", "mode_service", "simulated_robot")
    assert {f"/{robot}/{name}" for robot in ("left", "right") for name in names} <= {*peer("nodes")}
    assert peer("set_mode", mode=3, namespace="/left")["success"] is True
    assert world.status("left")["mode"] == "EMERGENCY_STOP"
    assert world.status("right")["mode"] == "IDLE"
    assert {topic["name"] for topic in world.status("right")["topics"]} >= {"/right/cmd_vel"}
    for robot in ("left", "right"):
        world.ok("stop", "--robot", robot)


def test_a_daemon_whose_socket_and_lock_are_removed_keeps_its_robot(world: World) -> None:
    world.ok("start", "--sim", "--drive", "circle")
    pid = world.status()["pid"]
    # As at a logout; both at once, because the daemon may create its socket again.
    rmtree((world.folder / "run" / "robotctl").rename(world.folder / "removed"))
    until(lambda: world.sockets() != [])
    world.robotctl("start", "--sim").failed(5, f"pid {pid} answers")
    status = world.status()
    assert status["mode"] == "MOVING", status["mode_reason"]
    world.ok("stop")
    assert len(list(world.recordings.iterdir())) == 1


@pytest.mark.parametrize("closed", [pytest.param("<&-", marks=SLOW), "<&- >&- 2>&-"])
def test_a_start_with_closed_streams_starts_as_any_other(world: World, closed: str) -> None:
    command = f"{ROBOTCTL} start --sim --config {world.patient} {closed}"
    started = subprocess.run(
        ["bash", "-c", command], env=world.environment, cwd=world.folder, check=False, timeout=60
    )
    assert started.returncode == 0
    pid = world.status()["pid"]
    assert {os.path.realpath(f"/proc/{pid}/fd/{number}") for number in (1, 2)} == {
        str(world.folder / "state" / "robotctl" / "robot" / "daemon.log")
    }
    world.ok("stop")


@pytest.mark.parametrize("closed", ["<&- 2>&-", pytest.param("<&- >&- 2>&-", marks=SLOW)])
def test_a_daemon_in_the_foreground_with_closed_streams_writes_into_no_file_of_ours(
    world: World, closed: str
) -> None:
    command = f"exec {ROBOTCTL} start --foreground --sim --config {world.patient} {closed}"
    with subprocess.Popen(
        ["bash", "-c", command], env=world.environment, cwd=world.folder, stdout=subprocess.DEVNULL
    ) as started:
        until(lambda: world.sockets() != [])
        until(lambda: world.robotctl("status").exit_code == 0)
        open_as = {os.path.realpath(f"/proc/{started.pid}/fd/{number}") for number in (0, 1)}
        assert open_as == {os.devnull}
        assert "pipe" in os.readlink(f"/proc/{started.pid}/fd/2")  # the log's queue
        world.ok("stop")
    assert started.returncode == 0


def test_what_cannot_be_started_is_one_sentence_and_starts_nothing(world: World) -> None:
    config, unknown = world.folder / "robot.yaml", world.folder / "unknown.yaml"
    config.write_text("limits.linear_mps: -1")
    unknown.write_text("socket.group: no_such_group\n")
    run, long = world.environment["XDG_RUNTIME_DIR"], str(world.folder / "run" / ("long" * 25))
    (world.folder / "file").write_text("")
    for options, variables, said in (
        (("--config", str(config)), {}, f"{config}: line 1: limits.linear_mps: -1 is not allowed"),
        (("--config", str(unknown)), {}, "there is no group 'no_such_group'"),
        ((), {"XDG_RUNTIME_DIR": long}, "longer than 107 bytes: set XDG_RUNTIME_DIR to a shorter"),
        ((), {"XDG_RUNTIME_DIR": str(world.folder / "file")}, f"{world.folder / 'file'} is not a"),
        ((), {"ROS_DOMAIN_ID": "233"}, "ROS_DOMAIN_ID is '233': use 0 to 232"),
    ):
        own = {"ROS_DOMAIN_ID": str(world.domain_id), "XDG_RUNTIME_DIR": run}
        world.environment |= own | variables
        world.here("start", "--sim", *options).refused(2, said)
        world.environment |= own
        assert not world.recordings.exists()
    assert world.robotctl("status").exit_code == 3


def test_a_start_fails_if_the_socket_path_is_not_a_socket(world: World) -> None:
    (world.folder / "run" / "robotctl").mkdir(mode=0o700)
    in_the_way = world.folder / "run" / "robotctl" / "robot.sock"
    in_the_way.write_text("mine")
    world.robotctl("start", "--sim").failed(2, f"{in_the_way} is not a socket")
    assert not world.recordings.exists()
    assert in_the_way.read_text() == "mine"
    in_the_way.unlink()


def test_a_start_that_may_open_too_few_files_is_refused(world: World) -> None:
    command = [ROBOTCTL, "start", "--sim", "--recordings", str(world.recordings)]
    limited = ["sh", "-c", 'ulimit -n 64; exec "$@"', "sh", *command]
    run_program(*limited, env=world.environment).failed(
        4, "this process may open 64 files, and a daemon needs 128: raise the limit"
    )
    assert not world.recordings.exists()


def test_a_failed_start_in_the_foreground_says_why_in_one_line(world: World) -> None:
    world.recordings.write_text("")
    err = world.robotctl("start", "--foreground", "--sim").refused(4)
    assert err.startswith("robotctl: cannot record into ")


@pytest.mark.parametrize("module", ["asyncio", "robotctl.daemon.app"])
def test_a_ctrl_c_while_the_daemon_is_still_importing_ends_it_without_a_traceback(
    module: str, world: World
) -> None:
    program = f"""
import runpy, signal, sys
class Interrupting:
    def find_spec(self, name, path, target=None):
        if name == {module!r}:
            signal.raise_signal(signal.SIGINT)
sys.meta_path.insert(0, Interrupting())
runpy.run_module("robotctl.daemon", run_name="__main__", alter_sys=True)
"""
    command = [sys.executable, "-P", "-c", program, "--robot", "robot"]
    ran = run_program(*command, env=world.environment, cwd=world.folder)
    assert (ran.exit_code, ran.err) == (130, "")


def test_a_start_takes_parameters_remaps_a_namespace_and_a_node_name(world: World) -> None:
    file = world.folder / "params.yaml"
    file.write_text("/lab/velocity:\n  ros__parameters: {limits.angular_rps: 1.0}\n")
    with Peer(world) as peer, world.peer("ParameterPeer") as client:
        world.ok(
            *("start", "--sim", "--config", str(world.patient)),
            *("--ros-args", "-r", "__ns:=/lab", "-r", "odom:=/base/odom"),
            *("-r", "mode_service:set_mode:=change_mode", "-r", "robot_status:=status"),
            *("-r", "velocity_publisher:__node:=velocity"),
            *("-p", "limits.linear_mps:=0.4", "--params-file", str(file)),
            *("--log-level", "lab.velocity:=debug"),
        )
        until(lambda: "/lab/velocity" in peer("nodes"))
        assert "/lab/velocity_publisher" not in peer("nodes")
        until(lambda: "/lab/change_mode" in peer("services"))
        assert "/base/odom" in peer("publishers")
        topics = {topic["name"] for topic in world.status()["topics"]}
        assert {"/lab/cmd_vel", "/base/odom", "/lab/status"} <= topics
        assert world.answer("param", "get", "limits.linear_mps")["value"] == 0.4
        assert world.answer("param", "get", "limits.angular_rps")["value"] == 1.0
        assert "DEBUG lab.velocity: Publishing: linear.x=0.0, angular.z=0.0" in world.log()
        until(lambda: "/lab/velocity" in client("visible"))
        assert client("get", node="/lab/velocity", keys=["limits.linear_mps"]) == [0.4]
        world.ok("set-mode", "moving")
        world.ok("set-mode", "idle")
        world.ok("stop")
    told = read_info(world.recording).metadata[INFO_RECORD]
    assert told["topic.robot_status"] == "/lab/status"
    assert told["service.set_mode"] == "/lab/change_mode"
    assert told["service.estop"] == "/lab/estop"


def test_a_wrong_argument_is_refused_before_a_daemon_starts(world: World) -> None:
    for words, said in (
        (["-r", "__ns:=/my lab"], "a namespace is /NAME"),
        (["-p", "limits.linear_mps:=fast"], "limits.linear_mps: 'fast' is not allowed"),
        (["--log-level", "loud"], "use debug, info, warn, error, fatal, or LOGGER:=LEVEL"),
        (["--params-file", "none.yaml"], "none.yaml: No such file"),
    ):
        ran = world.here("start", "--config", str(world.patient), "--ros-args", *words)
        ran.failed(2, said)
    assert world.here("status", "--ros-args", "-p", "a:=1").exit_code == 2
    assert not world.sockets()


def test_a_second_daemon_with_the_same_names_is_refused_and_disturbs_nobody(world: World) -> None:
    with new_world() as other:
        other.environment["ROS_DOMAIN_ID"] = world.environment["ROS_DOMAIN_ID"]
        world.may_lack = other.may_lack = "two daemons publish the same statuses"
        world.ok("start", "--sim", "--drive", "circle")
        other.robotctl("start", "--sim").failed(
            4, "has the same nodes: /velocity_publisher, /odom_subscriber", "--robot NAME"
        )
        assert world.status()["mode"] == "MOVING"
        other.ok("start", "--no-sim", "--allow-same-names")
        other.ok("stop")
        world.ok("stop")


MEMBER = 65502

IMPORTS = """
from robotctl.cli import app, quick
from robotctl.cli.targets import robots
"""


@as_root
def test_a_member_of_the_group_stops_the_robot_and_the_journal_names_the_user(world: World) -> None:
    group = grp.getgrgid(100)
    world.folder.chmod(0o711)
    (world.folder / "run").chmod(0o711)
    settings = f"socket.group: {group.gr_name}\nstandalone: true\n"
    started = world.ok("start", "--sim", settings=settings)
    assert f"each member of group {group.gr_name} may give commands (socket.group)" in started
    assert f"note: {world.folder}/robot.yaml: standalone is retired and ignored: " in started
    member = process_of(
        MEMBER, [group.gr_gid], IMPORTS, "raise SystemExit(app.run(['estop']))", world.environment
    )
    out, err = member.communicate(timeout=DEADLINE_S)
    assert (member.returncode, out.startswith("Mode changed to EMERGENCY_STOP")) == (0, True), err
    assert f") of uid {MEMBER}: " in world.status()["mode_reason"]
    world.ok("stop")
