"""`config` shows and checks configurations; the profiles of known robots are such files."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

from robotctl.config import Config, flat, load
from robotctl.profiles import Profile
from tests.cli.conftest import Cli

PROFILES = list(Profile)


def test_the_defaults_are_a_file_that_says_the_same(cli: Cli, tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(cli("config", "show").out)
    assert load(file) == Config()
    assert cli("config", "show", "--json").summary == flat(Config())


def test_what_a_file_makes_of_the_defaults_is_shown(cli: Cli, tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text("limits: {linear_mps: 0.3}\nrecording.exclude: [/scan]\n")
    shown = yaml.safe_load(cli("config", "show", "--config", str(file)).out)
    changed = {"limits.linear_mps": 0.3, "recording.exclude": ["/scan"]}
    assert shown == flat(Config()) | changed
    answer = cli("config", "validate", str(file), "--json").summary
    assert answer == {"file": str(file), "changed": changed}
    assert "is valid; changed from the defaults: 2" in cli("config", "validate", str(file)).out


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("limits.linear: 1", "limits.linear: no such key: did you mean limits.linear_mps?"),
        ("limits.linear_mps: 11", "use 0.01 to 10 m/s"),
        ("a: [", "not valid YAML"),
    ],
)
def test_a_wrong_file_is_named_with_what_is_allowed(
    cli: Cli, tmp_path: Path, text: str, said: str
) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(text)
    for command in (["validate", str(file)], ["show", "--config", str(file)]):
        cli("config", *command).refused(2, said)


@pytest.mark.parametrize("profile", PROFILES)
def test_a_profile_is_a_plain_file_to_copy(cli: Cli, tmp_path: Path, profile: Profile) -> None:
    copy = tmp_path / "robot.yaml"
    copy.write_text(cli("config", "show", "--profile", profile.value).out)
    assert copy.read_text() == profile.path.read_text()
    config = load(copy).kernel
    assert config.pattern.speed_mps < config.limits.linear_mps
    assert cli("config", "validate", str(copy)).exit_code == 0


@pytest.mark.parametrize("profile", PROFILES)
def test_each_number_of_a_profile_has_its_source(profile: Profile) -> None:
    text = profile.path.read_text()
    assert "battery.scale: " in text
    assert "not yet run on hardware" in " ".join(text.replace("#", "").lower().split())
    numbers = re.findall(r"^\w[\w.]*: [\d.]+ .*$|^\w[\w.]*: [\d.]+$", text, re.MULTILINE)
    assert len(numbers) >= 6
    assert [line for line in numbers if not re.search(r"# (source: \w|ours)", line)] == []


@pytest.mark.parametrize("command", [["config", "show"], ["start"]])
def test_a_profile_exists_and_is_given_without_a_file(cli: Cli, command: list[str]) -> None:
    err = cli(*command, "--profile", "turtlebot2").failed(2)
    files = Profile.HUSKY.path.parent.glob("*.yaml")
    assert all(path.stem in err for path in files), "each file of a robot is a profile"
    cli(*command, "--profile", "husky", "--config", "robot.yaml").failed(
        2, "--config with --profile"
    )


def test_start_passes_the_file_of_the_profile_to_the_daemon(cli: Cli) -> None:
    assert cli("start", "--profile", "husky").exit_code == 0
    assert f"'--config={Profile.HUSKY.path}'" in cli("logs").out
