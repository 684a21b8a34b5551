"""A wrong configuration is refused with file, key, value, and what is allowed."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from robotctl.base import retired
from robotctl.base.errors import ConfigError
from robotctl.config import MAX_FILE_BYTES, Config, flat, load, with_setting
from robotctl.kernel.patterns import PatternKind


def write(folder: Path, content: str | bytes) -> Path:
    path = folder / "robot.yaml"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


BAD = {
    "patterns that are no list": (
        "recording.exclude: /camera",
        "'/camera' is not allowed: use a list",
    ),
    "a pattern with a line break": ('recording.include: ["/a\\n"]', "use a topic (/scan), a glob"),
    "a pattern that steers a terminal": ('recording.exclude: ["/\\e[2J"]', "is not allowed"),
    "a pattern that is no text": ("recording.exclude: [/a, 7]", "7 is not allowed: use a topic"),
    "a relative name": ("recording.exclude: [camera]", "'camera' is not allowed: use a topic"),
    "unknown key": ("limits.linear_mp: 1", "limits.linear_mp: no such key: did you mean"),
    "unknown section": ("wheels: {radius: 1}", "wheels.radius: no such key"),
    "a section as a value": ("limits: 3", "limits: no such key"),
    "a value as a section": ("rate_hz: {a: 1}", "rate_hz.a: no such key: did you mean rate_hz?"),
    "negative limit": (
        "limits: {linear_mps: -1}",
        "limits.linear_mps: -1 is not allowed: use 0.01 to",
    ),
    "zero rate": ("rate_hz: 0", "rate_hz: 0 is not allowed: use 5 to 1000 Hz"),
    "nan": ("limits.linear_mps: .nan", "limits.linear_mps: nan is not allowed: use 0.01 to 10 m/s"),
    "inf": ("limits.linear_mps: .inf", "limits.linear_mps: inf is not allowed"),
    "huge number": ("rate_hz: 1" + "0" * 400, "rate_hz: 1000"),
    "too many digits": ("rate_hz: 1" + "0" * 5000, "not valid YAML"),
    "text for a number": ("rate_hz: fast", "rate_hz: 'fast' is not allowed: use a number"),
    "bool for a number": ("rate_hz: true", "rate_hz: True is not allowed: use a number"),
    "null for a number": ("rate_hz:", "rate_hz: None is not allowed: use a number"),
    "list for a number": ("rate_hz: [50]", "rate_hz: [50] is not allowed: use a number"),
    "date for a number": ("rate_hz: 2020-01-01", "rate_hz: datetime.date(2020, 1, 1) is not"),
    "fraction for a whole number": ("sim.seed: 1.5", "sim.seed: 1.5 is not allowed: use a whole"),
    "priority beyond the last": (
        "fifo_priority: 100",
        "fifo_priority: 100 is not allowed: use 0 to 99",
    ),
    "unknown pattern": ("pattern.kind: star", "pattern.kind: 'star' is not allowed: use square"),
    "unknown compression": (
        "recording.compression: zip",
        "'zip' is not allowed: use zstd, lz4, none",
    ),
    "no topic": ("odometry.topic: ''", "odometry.topic: '' is not allowed: use the name of a ROS"),
    "group with a line break": (
        'socket.group: "a\\nb"',
        "socket.group: 'a\\nb' is not allowed: use the name of a Unix group",
    ),
    "number for a group": ("socket.group: 100", "socket.group: 100 is not allowed: use the name"),
    "topic with a space": ("command.topic: 'a b'", "command.topic: 'a b' is not allowed"),
    "topic with //": ("battery.topic: 'a//b'", "battery.topic: 'a//b' is not allowed"),
    "number for a topic": ("command.topic: 3", "command.topic: 3 is not allowed"),
    "key twice": ("rate_hz: 50\nrate_hz: 20", "'rate_hz': is given twice"),
    "key twice, dotted and nested": (
        "limits: {linear_mps: 0.3}\nlimits.linear_mps: 0.4",
        "limits.linear_mps: is given twice",
    ),
    "clears below where it stops": (
        "battery: {stop_level: 0.3, clear_level: 0.25}",
        "battery.clear_level: 0.25 is not allowed: use at least battery.stop_level, 0.3",
    ),
    "overrun shorter than the period": (
        "rate_hz: 5",
        "max_tick_gap_s: 0.3 is not allowed: use at least two periods of rate_hz, 0.4 s",
    ),
    "two roles on one topic": (
        "odometry.topic: /cmd_vel",
        "odometry.topic: '/cmd_vel' is not allowed: command.topic is the same topic",
    ),
    "list": ("- a\n- b", "not a mapping of keys to values"),
    "text": ("hello", "not a mapping of keys to values"),
    "parameters that are no mapping": ("robot: {ros__parameters: 3}", "not a mapping"),
    "broken YAML": ("a: b: c", "not valid YAML"),
    "tag": ("!!python/object/apply:os.system ['true']", "not valid YAML"),
    "alias": ("a: &a [x]\nb: [*a, *a]", "aliases are not supported"),
    "alias of itself": ("&a a: *a", "aliases are not supported"),
    "nested beyond measure": ("[" * 50_000, "not valid YAML"),
    "binary": (bytes(range(256)), "not valid YAML"),
    "control characters in a key": (r'"\e[31m": 1', r"'\x1b[31m': no such key"),
    "huge": (b"# " + b"x" * MAX_FILE_BYTES, "larger than 1000000 bytes"),
}


@pytest.mark.parametrize(("content", "says"), BAD.values(), ids=BAD)
def test_a_bad_file_is_refused_in_one_sentence(
    tmp_path: Path, content: str | bytes, says: str
) -> None:
    path = write(tmp_path, content)
    with pytest.raises(ConfigError) as caught:
        load(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    assert says in text
    assert text.isprintable()
    assert caught.value.exit_code == 2


def test_a_file_that_is_not_there_or_not_a_file_is_refused(tmp_path: Path) -> None:
    for path, says in ((tmp_path / "none.yaml", "No such file"), (tmp_path, "Is a directory")):
        with pytest.raises(ConfigError, match=says):
            load(path)


@pytest.mark.parametrize("content", ["", "\n", "# nothing\n", "limits: {}", "{}"])
def test_an_empty_file_changes_nothing(tmp_path: Path, content: str) -> None:
    assert load(write(tmp_path, content)) == Config()


FORMS = {
    "dotted": "limits.linear_mps: 0.3\npattern.kind: circle\n",
    "nested": "limits:\n  linear_mps: 0.3\npattern: {kind: circle}\n",
    "mixed": "limits.linear_mps: 0.3\npattern: {kind: circle}\n",
    "ROS parameter file": (
        "robot:\n  ros__parameters:\n    limits: {linear_mps: 0.3}\n    pattern.kind: circle\n"
    ),
    "ROS parameter file for any node": (
        "/**:\n  ros__parameters:\n    limits.linear_mps: 0.3\n    pattern: {kind: circle}\n"
    ),
}


@pytest.mark.parametrize("content", FORMS.values(), ids=FORMS)
def test_every_form_of_a_file_says_the_same(tmp_path: Path, content: str) -> None:
    config = load(write(tmp_path, content))
    changed = {key: value for key, value in flat(config).items() if flat(Config())[key] != value}
    assert changed == {"limits.linear_mps": 0.3, "pattern.kind": "circle"}
    assert config.kernel.pattern.kind is PatternKind.CIRCLE


def test_what_flat_shows_can_be_loaded_again(tmp_path: Path) -> None:
    config = with_setting(Config(), "sim.seed", 42)
    assert load(write(tmp_path, yaml.safe_dump(flat(config)))) == config


def test_every_default_is_within_its_own_limits() -> None:
    config = Config()
    for key, value in flat(config).items():
        assert with_setting(config, key, value) == config


def test_every_number_has_limits_that_hold_at_both_ends() -> None:
    tried = 0
    for key, value in flat(Config()).items():
        if not isinstance(value, float):
            continue
        tried += 1
        with pytest.raises(ConfigError, match="use") as caught:
            with_setting(Config(), key, float("nan"))
        low, high = str(caught.value).rsplit("use ", 1)[1].split()[0:3:2]
        with_setting(Config(), key, float(low))
        with_setting(Config(), key, float(high))
        for outside in (float(low) - 1e-3 * abs(float(low)) - 1e-6, float(high) * 1.001):
            with pytest.raises(ConfigError):
                with_setting(Config(), key, outside)
    assert tried > 20


@pytest.mark.parametrize(
    "content",
    [
        'recording.throttle: {"/camera/*": 5, "type:sensor_msgs/msg/Image": 0.5}',
        'recording:\n  throttle:\n    "/camera/*": 5\n    type:sensor_msgs/msg/Image: 0.5\n',
        'recording.throttle: ["/camera/*=5", "type:sensor_msgs/msg/Image=0.5"]',
        "n: {ros__parameters: {recording.throttle: [/camera/*=5, type:sensor_msgs/msg/Image=0.5]}}",
    ],
)
def test_rates_by_topic_are_a_mapping_or_texts(tmp_path: Path, content: str) -> None:
    config = load(write(tmp_path, content))
    assert config.recording.throttle == ("/camera/*=5", "type:sensor_msgs/msg/Image=0.5")
    assert load(write(tmp_path, yaml.safe_dump(flat(config)))) == config


@pytest.mark.parametrize(
    "value",
    [
        *("5", '{"/camera": fast}', '{"/camera": -1}', "{camera: 5}", '["/camera"]', "[5]"),
        '{"/c": .nan}',
    ],
)
def test_what_is_no_rate_of_a_topic_is_refused(tmp_path: Path, value: str) -> None:
    with pytest.raises(ConfigError) as refused:
        load(write(tmp_path, f"recording.throttle: {value}"))
    assert 'such as {"/camera/*": 5}' in str(refused.value)


def test_a_whole_number_is_a_number(tmp_path: Path) -> None:
    config = load(write(tmp_path, "rate_hz: 100"))
    assert config.kernel.rate_hz == 100.0
    assert type(config.kernel.rate_hz) is float


def test_a_robot_may_have_no_battery_topic(tmp_path: Path) -> None:
    assert load(write(tmp_path, 'battery.topic: ""')).kernel.battery.topic == ""


def test_patterns_of_topics_are_read_as_they_stand(tmp_path: Path) -> None:
    content = "recording:\n  exclude: [/camera/*, 'type:sensor_msgs/msg/Image']\n  include: ['*']\n"
    config = load(write(tmp_path, content))
    assert config.recording.exclude == ("/camera/*", "type:sensor_msgs/msg/Image")
    assert config.recording.include == ("*",)
    assert load(write(tmp_path, yaml.safe_dump(flat(config)))) == config


@pytest.mark.parametrize("key", retired.CONFIG_KEYS)
def test_a_retired_key_is_ignored_with_one_warning(
    tmp_path: Path, key: str, caplog: pytest.LogCaptureFixture
) -> None:
    section, _, name = key.rpartition(".")
    nested = f"{section}:\n  {name}: 7" if section else f"{name}: 7"
    path = write(tmp_path, f"rate_hz: 40.0\n{nested}")
    assert load(path) == with_setting(Config(), "rate_hz", 40.0)
    (record,) = caplog.records
    assert record.getMessage() == (
        f"{path}: {key} is retired and ignored: {retired.CONFIG_KEYS[key]}"
    )
    with pytest.raises(ConfigError, match=f"{key} is retired: "):
        with_setting(Config(), key, "7")


def test_no_key_of_today_is_retired() -> None:
    assert not set(retired.CONFIG_KEYS) & set(flat(Config()))
