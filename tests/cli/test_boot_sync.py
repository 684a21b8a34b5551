"""The systemd timer that copies recordings: what it says, and that it is written and removed."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from robotctl.cli.support.sync_unit import sync_units

Cli = Callable[..., Any]

URL = "s3://bucket/robots/one"


@pytest.fixture
def units(home: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder of the user's units."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(home / "config"))
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


def test_the_service_copies_at_the_lowest_priority_with_what_was_given(
    cli: Cli, units: Path, home: Path
) -> None:
    ran = cli("boot", "sync", "show", "--json", "--", URL, "--limit-mbps", "20")
    timer, service = json.loads(ran.out)["units"]
    assert service["path"] == str(units / "robotctl-robot-sync.service")
    assert timer["path"] == str(units / "robotctl-robot-sync.timer")
    lines = service["text"].splitlines()
    for line in ("Type=oneshot", "Nice=19", "IOSchedulingClass=idle", "UMask=0077"):
        assert line in lines
    (start,) = (line for line in lines if line.startswith("ExecStart="))
    recordings = home / "state" / "robotctl" / "recordings" / "robot"
    assert start.endswith(
        f"robotctl sync {URL} --limit-mbps 20 --robot robot --recordings {recordings}"
    )
    assert "OnUnitInactiveSec=10min" in timer["text"]


def test_paths_do_not_depend_on_the_working_folder(cli: Cli, home: Path) -> None:
    shown = cli("boot", "sync", "show", "--", "usb", "--recordings", "mine").out
    assert f"robotctl sync {home}/cwd/usb --recordings {home}/cwd/mine --robot robot" in shown


def test_a_unit_of_the_machine_reaches_the_daemon_of_its_user(cli: Cli) -> None:
    _, service = sync_units("r2", (URL,), system=True, user="nobody", every_min=5)
    lines = service.text.splitlines()
    assert "User=nobody" in lines
    assert "Environment=XDG_RUNTIME_DIR=/run/robotctl-r2" in lines
    assert service.path == Path("/etc/systemd/system/robotctl-r2-sync.service")


@pytest.mark.parametrize("words", [["--dry-run"], ["--robot=r2"], ["--jsno"], ["--max-age-days"]])
def test_what_sync_would_not_take_is_refused_at_once(
    cli: Cli, units: Path, words: list[str]
) -> None:
    assert cli("boot", "sync", "install", "--", URL, *words).exit_code == 2
    assert not units.exists()


def test_installed_units_are_enabled_and_removed_again(
    cli: Cli, units: Path, systemctl: Path
) -> None:
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
    made = sync_units("robot", (URL, "--limit-mbps", "20"), system=True, user="root", every_min=10)
    for unit in made:
        (tmp_path / unit.name).write_text(unit.text)
    files = [str(tmp_path / unit.name) for unit in made]
    done = subprocess.run(
        ["systemd-analyze", "verify", *files], capture_output=True, text=True, check=False
    )
    about_them = [line for line in done.stderr.splitlines() if "robotctl-robot-sync" in line]
    assert about_them == [], done.stderr
