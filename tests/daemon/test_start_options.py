"""Starts with ROS arguments, a second daemon of the same names, a group for the socket."""

from __future__ import annotations

import grp

from robotctl.recording import Recording
from robotctl.recording.format.names import INFO_RECORD
from tests.support.lines import Told, peer_command
from tests.support.users import as_root, process_of
from tests.support.waiting import DEADLINE_S, until
from tests.support.world import Peer, World, new_world


def test_a_start_takes_parameters_remaps_a_namespace_and_a_node_name() -> None:
    with new_world() as world:
        file = world.folder / "params.yaml"
        file.write_text("/lab/velocity:\n  ros__parameters: {limits.angular_rps: 1.0}\n")
        peer = Peer(world)
        client = Told(peer_command("tests.support.role_peers", "ParameterPeer"), world.environment)
        try:
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
        finally:
            peer.close()
            client.close()
        with Recording(next(world.recordings.iterdir())) as recording:
            told = recording.info().metadata[INFO_RECORD]
        assert told["topic.robot_status"] == "/lab/status"
        assert (told["service.set_mode"], told["service.estop"]) == (
            "/lab/change_mode",
            "/lab/estop",
        )


def test_a_wrong_argument_is_refused_before_a_daemon_starts() -> None:
    with new_world() as world:
        for words, said in (
            (["-r", "__ns:=/my lab"], "a namespace is /NAME"),
            (["-p", "limits.linear_mps:=fast"], "limits.linear_mps: 'fast' is not allowed"),
            (["--log-level", "loud"], "use debug, info, warn, error, fatal, or LOGGER:=LEVEL"),
            (["--params-file", "none.yaml"], "none.yaml: No such file"),
        ):
            ran = world.here("start", "--config", str(world.patient), "--ros-args", *words)
            assert (ran.exit_code, said in ran.err) == (2, True), ran
        assert world.here("status", "--ros-args", "-p", "a:=1").exit_code == 2
        assert not world.sockets()


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
    config = world.folder / "robot.yaml"
    config.write_text(f"socket.group: {group.gr_name}\nstandalone: true\n")
    started = world.ok("start", "--sim", "--config", str(config))
    assert f"each member of group {group.gr_name} may give commands (socket.group)" in started
    assert f"note: {config}: standalone is retired and ignored: " in started
    member = process_of(
        MEMBER, [group.gr_gid], IMPORTS, "raise SystemExit(app.run(['estop']))", world.environment
    )
    out, err = member.communicate(timeout=DEADLINE_S)
    assert (member.returncode, out.startswith("Mode changed to EMERGENCY_STOP")) == (0, True), err
    assert f") of uid {MEMBER}: " in world.status()["mode_reason"]
    world.ok("stop")


def test_an_unknown_group_is_refused_by_name_and_nothing_starts(world: World) -> None:
    config = world.folder / "robot.yaml"
    config.write_text("socket.group: no_such_group\n")
    refused = world.robotctl("start", "--sim", "--config", str(config))
    assert refused.exit_code == 2
    assert "there is no group 'no_such_group'" in refused.err
    assert world.robotctl("status").exit_code == 3
