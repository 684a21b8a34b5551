"""`robotctl start --ros-args`: as launch files give parameters, remaps, namespace and names."""

from __future__ import annotations

from robotctl.recording import Recording
from robotctl.recording.format.names import INFO_RECORD
from tests.support.lines import Told, peer_command
from tests.support.waiting import until
from tests.support.world import Peer, new_world


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
            ran = world.robotctl("start", "--config", str(world.patient), "--ros-args", *words)
            assert (ran.exit_code, said in ran.err) == (2, True), ran
        ran = world.robotctl("status", "--ros-args", "-p", "a:=1")
        assert ran.exit_code == 2
        assert not world.sockets()
