"""systemd units: what they say, that nothing moves by them, and that they come and go."""

from __future__ import annotations

import pwd
import shutil
import subprocess
from pathlib import Path

import pytest

from robotctl.base.errors import AlreadyRunning, UsageError
from robotctl.cli.commands.boot import daemon_unit, sync_units
from tests.cli.conftest import Cli

URL = "s3://bucket/robots/one"


@pytest.fixture(autouse=True)
def units(home: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder of the user's units."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(home / "config"))
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    return home / "config" / "systemd" / "user"


@pytest.fixture
def systemctl(home: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Put a systemctl first in the path that notes its words; return the note."""
    said = home / "said"
    program = home / "bin" / "systemctl"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\necho "$@" >> {said}\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(program.parent), prepend=":")
    return said


def started(text: str) -> str:
    """Return the command of a service."""
    (line,) = (line for line in text.splitlines() if line.startswith("ExecStart="))
    return line


def test_the_unit_starts_the_daemon_as_one_that_reports(cli: Cli, units: Path, home: Path) -> None:
    made = cli("boot", "show", "--robot", "r2", "--json", "--", "--no-sim").summary
    assert made["path"] == str(units / "robotctl-r2.service")
    lines = made["text"].splitlines()
    for line in ("Type=notify", "Restart=on-failure", "WatchdogSec=10", "UMask=0077"):
        assert line in lines
    codes = f"{UsageError.exit_code} {AlreadyRunning.exit_code}"
    assert f"RestartPreventExitStatus={codes}" in lines, "another start does not heal these"
    assert "Environment=ROS_DOMAIN_ID=7" in lines
    assert f"Environment=XDG_STATE_HOME={home}/state" in lines, "the latch would be another one"
    recordings = f"{home}/state/robotctl/recordings/r2"
    assert started(made["text"]).endswith(
        f"robotctl start --foreground --robot r2 --no-sim --recordings {recordings}"
    )


def test_a_unit_of_the_machine_has_a_user_and_folders_of_that_user(home: Path) -> None:
    made = daemon_unit("robot", [], system=True, user="nobody")
    assert made.path == Path("/etc/systemd/system/robotctl-robot.service")
    assert "User=nobody" in made.text
    assert "RuntimeDirectoryMode=0711" in made.text, "socket.group may come in; the rest is private"
    assert "Environment=XDG_RUNTIME_DIR=/run/robotctl-robot" in made.text
    assert "WantedBy=multi-user.target" in made.text
    state = f"{pwd.getpwnam('nobody').pw_dir}/.local/state/robotctl"
    assert f"--recordings {state}/recordings/robot" in made.text
    assert str(home / "state") not in made.text
    with pytest.raises(UsageError, match="no user 'nobody_else'"):
        daemon_unit("robot", [], system=True, user="nobody_else")


def test_odd_words_are_quoted_as_systemd_reads_them() -> None:
    text = daemon_unit("robot", ["--config", '/a b/100%"$x'], system=False, user="ros").text
    assert '"/a b/100%%\\"$$x"' in text
    with pytest.raises(UsageError, match="printable"):
        daemon_unit("robot", ["--config", "/a\nUser=root"], system=False, user="ros")


@pytest.mark.parametrize("word", ["--drive", "--drive=square", "--foreground", "--robot", "--jsno"])
def test_nothing_moves_at_a_boot_and_what_start_would_not_take_is_refused(
    cli: Cli, units: Path, word: str
) -> None:
    assert cli("boot", "install", "--", word).exit_code == 2
    assert not units.exists()


def test_paths_do_not_depend_on_the_working_folder(cli: Cli, home: Path) -> None:
    shown = cli("boot", "show", "--", "--config", "robot.yaml", "--recordings=mine").out
    assert f"--config {home}/cwd/robot.yaml --recordings={home}/cwd/mine\n" in shown
    shown = cli("boot", "sync", "show", "--", "usb", "--recordings", "mine").out
    assert f"robotctl sync {home}/cwd/usb --recordings {home}/cwd/mine --robot robot\n" in shown
    shown = cli("boot", "sync", "show", "--", "mine", "usb").out
    assert f"robotctl sync {home}/cwd/mine {home}/cwd/usb --robot robot\n" in shown


def test_the_daemons_unit_is_enabled_and_removed(cli: Cli, units: Path, systemctl: Path) -> None:
    assert "written, enabled and started" in cli("boot", "install", "--", "--no-sim").out
    assert [path.name for path in units.iterdir()] == ["robotctl-robot.service"]
    assert cli("boot", "remove").exit_code == 0
    assert systemctl.read_text().splitlines() == [
        "--user daemon-reload",
        "--user enable --now robotctl-robot.service",
        "--user disable --now robotctl-robot.service",
        "--user daemon-reload",
    ]
    assert list(units.iterdir()) == []
    assert cli("boot", "remove").exit_code == 4


def test_without_systemd_the_unit_is_written_and_the_command_that_enables_it_is_named(
    cli: Cli, units: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", "")
    cli("boot", "install", "--", "--no-sim").succeeded(
        "systemctl --user enable --now robotctl-robot.service"
    )
    assert (units / "robotctl-robot.service").is_file()


def test_units_of_copies_are_enabled_and_removed(cli: Cli, units: Path, systemctl: Path) -> None:
    assert cli("boot", "sync", "install", "--every", "3", "--", URL).exit_code == 0
    assert sorted(path.suffix for path in units.iterdir()) == [".service", ".timer"]
    assert systemctl.read_text().splitlines() == [
        "--user daemon-reload",
        "--user enable --now robotctl-robot-sync.timer",
    ]
    assert cli("boot", "sync", "remove").exit_code == 0
    assert list(units.iterdir()) == []
    assert "--user disable --now robotctl-robot-sync.timer" in systemctl.read_text()
    assert cli("boot", "sync", "remove").exit_code == 4


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed")
def test_systemd_accepts_the_units(tmp_path: Path) -> None:
    made = (
        daemon_unit("robot", ["--no-sim"], system=True, user="root"),
        *sync_units("robot", [URL], system=True, user="root", every_min=10),
    )
    for unit in made:
        (tmp_path / unit.path.name).write_text(unit.text)
    files = [str(tmp_path / unit.path.name) for unit in made]
    done = subprocess.run(
        ["systemd-analyze", "verify", *files], capture_output=True, text=True, check=False
    )
    about_them = [line for line in done.stderr.splitlines() if "robotctl-robot" in line]
    assert about_them == [], done.stderr
