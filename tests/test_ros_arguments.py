"""`--ros-args`: parameters, files of them, remaps, namespace and node names, and what is wrong.

`--log-level` takes what ROS takes, and names what it does not.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from robotctl.base import retired, ros_arguments
from robotctl.base.errors import ConfigError, UsageError
from robotctl.base.ros_arguments import LogLevel, Remap, level_name, read_log_level, with_log_levels
from robotctl.config import Config, flat
from robotctl.config.ros_settings import RosSettings, apply_arguments, check_parameter_files
from robotctl.daemon.command_line import parse
from tests.support.cases import for_each


def applied(*words: str, namespace: str = "") -> RosSettings:
    return apply_arguments(Config(), ros_arguments.parse(words), namespace)


def write(folder: Path, text: str) -> Path:
    file = folder / "robot.yaml"
    file.write_text(text)
    return file


def test_the_sections_are_cut_out_of_a_command_line() -> None:
    line = ["start", "--ros-args", "-p", "a:=1", "--", "--sim", "--ros-args", "-r", "b:=c"]
    assert ros_arguments.split(line) == (["start", "--sim"], ["-p", "a:=1", "-r", "b:=c"])


def test_parameters_are_applied_in_their_order_and_a_later_one_wins(tmp_path: Path) -> None:
    file = write(
        tmp_path,
        "/**:\n  ros__parameters:\n    limits: {linear_mps: 0.3, angular_rps: 1}\n"
        "    use_sim_time: true\n"
        "other_node:\n  ros__parameters: {speed: 3}\n",
    )
    words = ["-p", "limits.linear_mps:=0.2", "--params-file", str(file)]
    settings = applied(*words, "-p", "velocity_publisher:limits.angular_rps:=1.2")
    values = flat(settings.config)
    assert (values["limits.linear_mps"], values["limits.angular_rps"]) == (0.3, 1.2)
    assert settings.use_sim_time


@pytest.mark.parametrize("key", retired.CONFIG_KEYS)
def test_a_retired_parameter_is_ignored_with_one_warning(
    tmp_path: Path, key: str, caplog: pytest.LogCaptureFixture
) -> None:
    file = write(tmp_path, f"/**: {{ros__parameters: {{{key}: 7}}}}")
    settings = applied("--params-file", str(file), "-p", f"{key}:=x", "-p", "rate_hz:=40.0")
    assert flat(settings.config) == flat(Config()) | {"rate_hz": 40.0}
    (record,) = caplog.records
    assert record.getMessage() == f"{key} is retired and ignored: {retired.CONFIG_KEYS[key]}"


@pytest.mark.parametrize(
    "name",
    [
        "/r2/odom_subscriber",
        "odom_subscriber",
        "/**/odom_subscriber",
        "/**",
        "/r2/*",
        "/*/odom_subscriber",
    ],
)
def test_a_file_names_the_node_or_a_pattern_of_it(tmp_path: Path, name: str) -> None:
    file = write(tmp_path, f"{name}: {{ros__parameters: {{odometry.timeout_s: 2.0}}}}")
    settings = applied("--params-file", str(file), namespace="/r2")
    assert flat(settings.config)["odometry.timeout_s"] == 2.0


def test_a_file_may_nest_the_namespace(tmp_path: Path) -> None:
    file = write(tmp_path, "/r2:\n  mode_service:\n    ros__parameters: {battery.topic: ''}\n")
    settings = applied("--params-file", str(file), namespace="/r2")
    assert flat(settings.config)["battery.topic"] == ""


def test_a_remap_of_a_configured_topic_becomes_its_key_and_others_are_for_rcl() -> None:
    settings = applied("-r", "odom:=/base/odom", "-r", "set_mode:=mode", namespace="/r2")
    assert flat(settings.config)["odometry.topic"] == "/base/odom"
    assert settings.remaps == (Remap("", "set_mode", "mode"),)
    settings = applied("-r", "/r2/cmd_vel:=/cmd_vel", namespace="/r2")
    assert flat(settings.config)["command.topic"] == "/cmd_vel"
    assert settings.remaps == ()


def test_the_topics_of_safety_inputs_are_remapped_too() -> None:
    settings = applied("-r", "estop_pressed:=/base/estop", namespace="/r2")
    assert flat(settings.config)["inputs.estop.topic"] == "/base/estop"


@for_each(("namespace", "meant"), [("/r2", "/r2"), ("r2", "/r2"), ("/a/b/", "/a/b"), ("/", "")])
def test_a_namespace_replaces_that_of_the_robot(namespace: str, meant: str) -> None:
    options = parse(["--robot", "left", "--ros-args", "-r", f"__ns:={namespace}"])
    assert (options.namespace, options.robot) == (meant, "left")
    assert parse(["--robot", "left"]).namespace == "/left"


def test_a_node_gets_a_new_name_by_its_usual_one(tmp_path: Path) -> None:
    words = ["-r", "mode_service:__node:=modes"]
    assert ros_arguments.parse(words).node_names == {"mode_service": "modes"}
    file = write(tmp_path, "modes: {ros__parameters: {battery.topic: ''}}")
    assert flat(applied(*words, "--params-file", str(file)).config)["battery.topic"] == ""


WRONG = {
    "a namespace with a space": (["-r", "__ns:=/my robot"], "letters, digits and underscores"),
    "an empty namespace part": (["-r", "__ns:=//a"], "a namespace is /NAME"),
    "a namespace of one node": (["-r", "mode_service:__ns:=/a"], "all nodes share one"),
    "one name for all nodes": (["-r", "__node:=x"], "the daemon has 4 nodes: name one of"),
    "a name of no node": (["-r", "modes:__node:=x"], "there is no node 'modes'"),
    "a node name with a space": (["-r", "mode_service:__node:=a b"], "a node's name has letters"),
    "no value": (["-p"], "--ros-args -p: the value is missing"),
    "no sign": (["-p", "limits.linear_mps=1"], "is not allowed: use -p KEY:=VALUE"),
    "no key": (["-p", ":=1"], "is not allowed"),
    "an unknown option": (["--enclave", "/x"], "--ros-args '--enclave' is not supported"),
    "an unknown parameter": (["-p", "limits.linear_mp:=1"], "did you mean limits.linear_mps?"),
    "a wrong type": (["-p", "limits.linear_mps:=fast"], "'fast' is not allowed: use a number"),
    "out of range": (["-p", "limits.linear_mps:=11.0"], "use 0.01 to 10 m/s"),
    "no YAML": (["-p", "limits.linear_mps:=[1"], "not valid YAML"),
    "a parameter of another node": (
        ["-p", "odom_subscriber:limits.linear_mps:=1.0"],
        "limits.linear_mps: is no parameter of odom_subscriber: it is one of velocity_publisher",
    ),
    "a parameter of no node": (["-p", "talker:speed:=1.0"], "there is no node 'talker'"),
    "two that do not fit": (["-p", "battery.stop_level:=0.5"], "at least battery.stop_level"),
    "a remap that is no name": (["-r", "odom:=a b"], "a name is /a/b or a/b"),
    "a remap onto another topic": (["-r", "odom:=cmd_vel"], "command.topic is the same topic"),
    "time that is no boolean": (["-p", "use_sim_time:=1"], "use true or false"),
    "a file that is missing": (["--params-file", "/nowhere/x.yaml"], "No such file"),
}


@for_each(("words", "said"), WRONG.values())
def test_a_wrong_argument_is_named(words: list[str], said: str) -> None:
    with pytest.raises((UsageError, ConfigError)) as refused:
        applied(*words)
    assert said in str(refused.value)


WRONG_FILES = {
    "for another node": (
        "/talker: {ros__parameters: {speed: 1.0}}",
        "is for /talker, not for a node of this daemon: use /**, or /r2/velocity_publisher",
    ),
    "for the node in another namespace": (
        "/r3/mode_service: {ros__parameters: {battery.topic: ''}}",
        "is for /r3/mode_service, not for a node",
    ),
    "a key of another node": (
        "odom_subscriber: {ros__parameters: {limits.linear_mps: 1.0}}",
        "is no parameter of odom_subscriber: it is one of velocity_publisher",
    ),
    "no parameter file": ("limits.linear_mps: 1.0", "stands outside of a node's"),
    "nothing": ("", "not a ROS parameter file"),
    "an unknown key": (
        "/**: {ros__parameters: {limits.linear_mp: 1.0}}",
        "limits.linear_mp: no such key",
    ),
}


@pytest.mark.parametrize(("text", "said"), WRONG_FILES.values(), ids=WRONG_FILES.keys())
def test_a_wrong_file_of_parameters_is_named(tmp_path: Path, text: str, said: str) -> None:
    file = write(tmp_path, text)
    with pytest.raises(ConfigError) as refused:
        applied("--params-file", str(file), namespace="/r2")
    assert said in str(refused.value)


def test_a_file_of_an_executable_names_its_node(tmp_path: Path) -> None:
    words = ["velocity_publisher", "--ros-args", "--params-file"]
    file = write(tmp_path, "/talker: {ros__parameters: {sweep: true}}")
    with pytest.raises(ConfigError, match="is for /talker, not for /velocity_publisher"):
        check_parameter_files([*words, str(file)], "/velocity_publisher")
    file = write(tmp_path, "velocity_publisher: {ros__parameters: {sweep: true}}")
    check_parameter_files([*words, str(file)], "/r2/velocity_publisher")
    check_parameter_files([*words[:1], "--params-file", "/nowhere"], "/velocity_publisher")


@for_each(
    ("text", "level"),
    [
        ("debug", LogLevel("", 10)),
        ("WARN", LogLevel("", 30)),
        ("r2.mode_service:=fatal", LogLevel("r2.mode_service", 50)),
    ],
)
def test_a_level_is_for_all_loggers_or_for_a_named_one(text: str, level: LogLevel) -> None:
    assert read_log_level(text) == level


@for_each("text", ["", "loud", "warning", "10", ":=debug", "rcl:=", "rcl=debug"])
def test_another_level_is_named_with_those_that_are_allowed(text: str) -> None:
    with pytest.raises(UsageError, match="use debug, info, warn, error, fatal, or LOGGER:=LEVEL"):
        read_log_level(text)


def test_a_level_between_two_names_has_the_lower_one() -> None:
    assert [level_name(level) for level in (0, 9, 10, 25, 99)] == [
        *("UNSET", "UNSET", "DEBUG", "INFO", "FATAL")
    ]


def test_an_executable_hands_its_levels_to_rcl() -> None:
    line = ["odom_subscriber", "--log-level", "debug", "--log-level=rcl:=warn"]
    rest = ["--ros-args", "-p", "a:=1", "--log-level", "error"]
    expected = [*rest, "--ros-args", "--log-level", "debug", "--log-level", "rcl:=warn"]
    assert with_log_levels([*line, *rest]) == ["odom_subscriber", *expected]
    assert with_log_levels(rest) == rest
    with pytest.raises(UsageError, match="--log-level '' is not allowed"):
        with_log_levels(["odom_subscriber", "--log-level"])


def test_a_level_among_the_ros_arguments_is_read() -> None:
    levels = ros_arguments.parse(["--log-level", "info", "--log-level", "rcl:=debug"]).log_levels
    assert levels == (LogLevel("", 20), LogLevel("rcl", 10))
    with pytest.raises(UsageError, match="--log-level 'loud' is not allowed"):
        ros_arguments.parse(["--log-level", "loud"])
