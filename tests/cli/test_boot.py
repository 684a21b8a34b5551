"""The systemd unit: what it says, and that nothing moves by it."""

from __future__ import annotations

import pwd
import shutil
import subprocess
from pathlib import Path

import pytest

from robotctl.cli.commands.boot.group import me, start_arguments
from robotctl.cli.support.boot_unit import unit
from robotctl.errors import AlreadyRunning, UsageError


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    return tmp_path


def test_the_unit_starts_the_daemon_as_one_that_reports(home: Path) -> None:
    made = unit("r2", ("--no-sim",), system=False, user="ros")
    assert made.path == home / "config" / "systemd" / "user" / "robotctl-r2.service"
    assert made.scope == ("--user",)
    lines = made.text.splitlines()
    for line in ("Type=notify", "Restart=on-failure", "WatchdogSec=10", "UMask=0077"):
        assert line in lines
    assert "Environment=ROS_DOMAIN_ID=7" in lines
    assert f"Environment=XDG_STATE_HOME={home}/state" in lines, "the latch would be another one"
    (start,) = (line for line in lines if line.startswith("ExecStart="))
    assert start.endswith(
        f"robotctl start --foreground --robot r2 --recordings {home}/state/robotctl/recordings/r2 "
        "--no-sim"
    )


def test_a_unit_of_the_machine_has_a_user_and_a_runtime_folder(home: Path) -> None:
    made = unit("robot", (), system=True, user="nobody")
    assert made.path == Path("/etc/systemd/system/robotctl-robot.service")
    assert "User=nobody" in made.text
    assert "RuntimeDirectoryMode=0711" in made.text, "socket.group may come in; the rest is private"
    assert "Environment=XDG_RUNTIME_DIR=/run/robotctl-robot" in made.text
    assert "WantedBy=multi-user.target" in made.text


def test_a_unit_of_the_machine_records_where_its_user_may_write(home: Path) -> None:
    other = pwd.getpwnam("nobody")
    text = unit("robot", (), system=True, user=other.pw_name).text
    assert f"--recordings {other.pw_dir}/.local/state/robotctl/recordings/robot" in text
    assert str(home / "state") not in text
    with pytest.raises(UsageError, match="no user 'nobody_else'"):
        unit("robot", (), system=True, user="nobody_else")


def test_under_sudo_the_one_who_called_it_runs_the_daemon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SUDO_USER", "ada")
    assert me() == "ada"


def test_what_another_start_does_not_heal_is_not_started_again(home: Path) -> None:
    text = unit("robot", (), system=False, user="ros").text
    codes = f"{UsageError.exit_code} {AlreadyRunning.exit_code}"
    assert f"RestartPreventExitStatus={codes}" in text.splitlines()


def test_odd_words_are_quoted_as_systemd_reads_them(home: Path) -> None:
    text = unit("robot", ("--config", '/a b/100%"$x'), system=False, user="ros").text
    assert '"/a b/100%%\\"$$x"' in text
    with pytest.raises(UsageError, match="printable"):
        unit("robot", ("--config", "/a\nUser=root"), system=False, user="ros")


@pytest.mark.parametrize("word", ["--drive", "--drive=square", "--foreground", "--robot"])
def test_nothing_moves_at_a_boot(word: str) -> None:
    with pytest.raises(UsageError, match="in a unit"):
        start_arguments([word])


def test_paths_do_not_depend_on_the_working_folder() -> None:
    here = str(Path("robot.yaml").absolute())
    assert start_arguments(["--config", "robot.yaml", "--no-sim"]) == ("--config", here, "--no-sim")


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed")
def test_systemd_accepts_the_unit(home: Path) -> None:
    made = unit("robot", ("--no-sim",), system=True, user="root")
    file = home / made.name
    file.write_text(made.text)
    done = subprocess.run(
        ["systemd-analyze", "verify", str(file)], capture_output=True, text=True, check=False
    )
    about_it = [line for line in done.stderr.splitlines() if made.name in line]
    assert about_it == [], done.stderr
