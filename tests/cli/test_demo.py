"""The demo affects no other daemon, leaves nothing behind, and shows what it did."""

from __future__ import annotations

import shlex
import signal
from pathlib import Path
from typing import Any

import pytest

from robotctl.cli.commands import sim
from robotctl.cli.ui import text
from robotctl.ipc.client import call
from robotctl.recording import read_info
from tests.cli.conftest import Cli, Spawn
from tests.support.lines import line_of


def sockets(home: Path) -> list[str]:
    return [path.stem for path in (home / "run" / "robotctl").glob("*.sock")]


@pytest.mark.usefixtures("wide_terminal")
def test_the_demo_shows_what_was_recorded_and_touches_no_running_daemon(
    daemon: None, cli: Cli, home: Path
) -> None:
    before = call("robot", "status")
    out = cli("demo").succeeded()
    folder = next(Path("recordings").glob("demo_*"))
    assert (folder / "path.png").stat().st_size > 1000
    for shown in (
        f"recording   {folder}",
        f"picture     {folder}/path.png",
        "messages    20, 0 lost",
        "/odom",
        "off track   0.008 m RMS, 0.021 m at most",
        "closure     0.012 m",
        "\u2502",
    ):
        assert shown in out
    assert max(len(line) for line in out.splitlines()) <= 80
    assert sockets(home) == ["robot"]
    after = call("robot", "status")
    assert (after["pid"], after["mode"]) == (before["pid"], "IDLE")
    assert read_info(folder).missing == ()
    (log,) = home.glob("state/robotctl/demo_*/daemon.log")
    assert f"'--config={sim.CONFIG}'" in log.read_text()


def test_the_last_screen_of_80_by_24_shows_every_number_and_commands_to_paste(
    cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sim, "terminal_lines", lambda: 24)
    monkeypatch.setattr(text, "_terminal_columns", lambda: 80)
    out = cli("demo", "--recordings", "my recordings").out
    last_screen = "\n".join(out.splitlines()[-23:])  # the prompt is below
    for label in ("driven path", "recording", "picture", "messages", "off track", "closure"):
        assert label in last_screen
    assert "next:" in last_screen
    pasted = [shlex.split(line) for line in out.split("next:\n")[1].splitlines()]
    assert [words[:2] for words in pasted] == [
        ["robotctl", command] for command in ("report", "replay", "start")
    ]
    assert cli(*pasted[0][1:]).exit_code == 0


def test_keep_leaves_the_daemon_and_says_how_to_go_on(cli: Cli, home: Path) -> None:
    out = cli("demo", "--keep").out
    (robot,) = sockets(home)
    assert call(robot, "status")["mode"] == "IDLE"
    pasted = [shlex.split(line) for line in out.split("next:\n")[1].splitlines()]
    assert pasted[-1] == ["robotctl", "stop", "--robot", robot]
    assert cli(*pasted[-1][1:]).exit_code == 0
    assert sockets(home) == []


def test_json_is_one_line_with_every_number(cli: Cli) -> None:
    ran = cli("demo", "--json")
    assert ran.out.count("\n") == 1
    said = ran.summary
    assert said["messages"] == {"/odom": 20}
    assert said["lost"] == 0
    assert Path(said["picture"]).exists()
    assert said["cross_track_max_m"] == 0.021


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_an_interruption_stops_the_daemon_and_leaves_a_readable_recording(
    number: signal.Signals, spawn: Spawn, home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAKE_ENDLESS", "1")
    process = spawn("demo")
    while "MOVING" not in line_of(process.stdout):
        assert process.poll() is None
    process.send_signal(number)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 130
    folder = next(Path("recordings").glob("demo_*"))
    assert err == (
        "note: a sourced ROS (humble) was left out\n"
        f"stopped; recorded until then: {folder}/{folder.name}_0.mcap\n"
    )
    assert sockets(home) == []
    assert read_info(folder).message_count == 20


def test_a_daemon_that_does_not_start_is_told(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FAKE_START", "refuse")
    err = cli("demo").failed(2)
    assert err == "robotctl: robot.yaml: speed: nan is not allowed\n"


@pytest.mark.parametrize(
    ("early", "number"),
    [(True, signal.SIGINT), (True, signal.SIGHUP), (False, signal.SIGTERM), (False, signal.SIGHUP)],
)
def test_signals_during_the_clean_up_leave_no_daemon_behind(
    early: bool, number: signal.Signals, cli: Cli, home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A terminal that closes sends two signals, and so may a user."""
    stop, lap = sim._stop_if_running, sim._drive_one_lap

    def stop_under_signals(robot: str) -> None:
        signal.raise_signal(number)
        stop(robot)

    def interrupted_lap(robot: str, *, quiet: bool) -> Any:
        if early:
            signal.raise_signal(number)
        return lap(robot, quiet=quiet)

    monkeypatch.setattr(sim, "_stop_if_running", stop_under_signals)
    monkeypatch.setattr(sim, "_drive_one_lap", interrupted_lap)
    assert cli("demo").exit_code == (130 if early else 0)
    assert sockets(home) == []
