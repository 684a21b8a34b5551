"""The executable `mode_service` takes `--ros-args` as `robotctl start` does, for its one node."""

from __future__ import annotations

from pathlib import Path

import pytest

from robotctl.config import Config, flat
from robotctl.daemon.mode_service import options_of
from robotctl.errors import ConfigError, UsageError
from robotctl.ros_arguments import Remap


def test_parameters_come_from_the_line_and_from_the_file_of_a_launch(tmp_path: Path) -> None:
    file = tmp_path / "launch_params"
    file.write_text(
        "/**:\n  ros__parameters:\n    robot_name: r2\n    standalone: false\n"
        "    use_sim_time: true\n    limits.linear_mps: 0.3\n"
    )
    words = ["mode_service", "--ros-args", "-r", "__node:=modes", "-r", "__ns:=/lab"]
    options = options_of([*words, "--params-file", str(file), "-p", "odometry.timeout_s:=2.0"])
    assert (options.robot, options.namespace, options.owner) == ("r2", "/lab", True)
    assert options.ros.node_names == {"mode_service": "modes"}
    settings = options.applied_to(Config())
    values = flat(settings.config)
    assert (values["limits.linear_mps"], values["odometry.timeout_s"]) == (0.3, 2.0)
    assert (values["standalone"], settings.use_sim_time) == (False, True)


def test_a_remap_is_the_same_as_in_the_daemon() -> None:
    line = ["mode_service", "--ros-args", "-r", "odom:=/base/odom", "-r", "set_mode:=mode"]
    settings = options_of(line).applied_to(Config())
    assert flat(settings.config)["odometry.topic"] == "/base/odom"
    assert settings.remaps == (Remap("", "set_mode", "mode"),)
    assert flat(settings.config)["standalone"] is True


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["-r", "__ns:=/my lab"], "a namespace is /NAME"),
        (["-r", "talker:__node:=x"], "there is no node 'talker'"),
        (["-p", "limits.linear_mp:=1.0"], "did you mean limits.linear_mps?"),
        (["-p", "use_sim_time:=3"], "use true or false"),
    ],
)
def test_a_wrong_argument_is_named(words: list[str], said: str) -> None:
    with pytest.raises((ConfigError, UsageError)) as refused:
        options_of(["mode_service", "--ros-args", *words]).applied_to(Config())
    assert said in str(refused.value)


def test_a_file_for_another_node_is_named(tmp_path: Path) -> None:
    file = tmp_path / "p.yaml"
    file.write_text("/talker: {ros__parameters: {speed: 1.0}}")
    with pytest.raises(ConfigError, match="is for /talker, not for a node of this daemon"):
        options_of(["mode_service", "--ros-args", "--params-file", str(file)])
