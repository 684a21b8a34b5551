"""status, set-mode, estop, reset, stop and drive, with reasons, against fake daemons."""

from __future__ import annotations

import json
import os
import pty
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from itertools import count
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from PIL import Image

from robotctl.base import processes
from robotctl.base.errors import UsageError
from robotctl.base.text import MODES
from robotctl.cli import quick
from robotctl.cli.commands.drive import tracking_lines
from robotctl.cli.targets.driving import Background, stop_drive
from robotctl.ipc.answers import DriveAnswer, Status
from robotctl.ipc.client import Client, call
from robotctl.ipc.protocol import EMERGENCY_STOP_MODE
from robotctl.kernel.modes import Mode
from tests.cli.conftest import Cli, Spawn
from tests.support.lines import line_of
from tests.support.waiting import DEADLINE_S, until

DRIVING = "robotctl.cli.targets.driving"
PICTURE = Path("recordings/robot_20260101_120000/path.png")


def mode() -> str:
    return str(call("robot", "status")["mode"])


@pytest.mark.usefixtures("wide_terminal")
def test_status_is_one_screen_of_80_columns_and_one_line_of_json(daemon: None, cli: Cli) -> None:
    out = cli("status").succeeded("warning: \\x1b[2Jforged")
    lines = out.splitlines()
    assert lines[0] == "robot: IDLE"
    assert len(lines) <= 24
    shown = " ".join(lines)
    for text in ("x +0.500 m", "+0.200 m/s", "87 %", "recording", "domain 0", "LOCALHOST", "/odom"):
        assert text in shown
    # The socket's path is as long as the temporary folder's; everything else has its columns.
    assert all(len(line) <= 80 for line in lines if "socket" not in line)
    told = cli("status", "--json").out
    assert "\x1b" not in out + told
    assert told.count("\n") == 1
    assert json.loads(told).keys() >= Status.__required_keys__
    assert json.loads(told)["mode"] == "IDLE"


def test_a_mode_is_taken_in_any_case_with_dash_or_underscore_or_as_a_number() -> None:
    for number, texts in (
        (0, ("idle", "0")),
        (1, ("MOVING",)),
        (2, ("Error",)),
        (3, ("emergency-stop", "EMERGENCY_STOP", "emergency_Stop", "3")),
    ):
        assert {quick.mode_number(text) for text in texts} == {number}


def test_set_mode_answers_as_the_service_does_and_tells_who_asked(daemon: None, cli: Cli) -> None:
    assert cli("set-mode", "moving").out == "Mode changed to MOVING\n"
    reason = call("robot", "status")["mode_reason"]
    assert reason == f"robotctl set-mode (uid {os.getuid()}, pid {os.getpid()})"
    told = {"message": "Mode changed to IDLE", "mode": "IDLE"}
    assert cli("set-mode", "idle", "--json").summary == told


def test_estop_says_how_to_release_it_and_a_refusal_exits_with_4(daemon: None, cli: Cli) -> None:
    ran = cli("estop")
    assert ran.out == "Mode changed to EMERGENCY_STOP (release it with: robotctl reset)\n"
    err = cli("set-mode", "moving").refused(4)
    assert err == "robotctl: EMERGENCY_STOP is latched: release it with robotctl reset\n"
    assert cli("reset").out == "Mode changed to IDLE\n"
    assert cli("set-mode", "moving").exit_code == 0


def test_stop_returns_when_the_process_is_gone(daemon: None, cli: Cli) -> None:
    with Client("robot") as client, processes.pidfd_of(client.daemon_pid) as watched:
        assert watched is not None
        assert cli("stop").exit_code == 0
        assert processes.readable_within(watched, 0)
    assert cli("stop").exit_code == 3


def test_a_daemon_that_does_not_end_is_named(
    daemon: None, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(processes, "readable_within", lambda process, seconds: False)
    pid = call("robot", "status")["pid"]
    cli("stop").failed(1, f"(pid {pid}) is still running after 30 s: end it with kill -9 {pid}")


def test_drive_starts_and_is_not_replaced_by_accident_and_status_tells_its_errors(
    daemon: None, cli: Cli
) -> None:
    assert "off track" not in cli("status").out
    assert cli("drive", "square", "--side", "2").out == "Driving square 2.0 m\n"
    told = cli("status").out
    lines = (
        "  drive      a square, lap 1 of 2, for 1.5 s",
        "             off track 0.001 m, 0.002 m RMS, 0.003 m at most (0.013 m in truth)",
        "             heading 0.010 rad RMS, 0.020 rad at most, closure 0.004 m",
    )
    assert "\n".join(lines) in told
    assert max(map(len, lines)) <= 80
    cli("drive", "circle").failed(4, "--replace")
    assert cli("drive", "circle", "--replace").exit_code == 0


def test_drive_wait_ends_with_the_tracking_numbers_and_a_picture_beside_the_recording(
    daemon: None, cli: Cli
) -> None:
    ran = cli("drive", "square", "--wait")
    assert ran.out.splitlines() == [
        "Drive finished",
        "  driven      1 lap, 4.000 m in 17.3 s",
        "  off track   0.008 m RMS, 0.021 m at most",
        "  heading     0.020 rad RMS, 0.050 rad at most",
        "  closure     0.012 m from where the lap ends",
        f"  picture     {PICTURE}",
    ]
    PICTURE.unlink()
    cli("drive", "square", "--replace")
    assert not PICTURE.exists()
    answer = cli("drive", "square", "--wait", "--replace", "--json").summary
    numbers = {"laps", "distance_m", "cross_track_rms_m", "cross_track_max_m", "closure_m"}
    assert answer.keys() >= numbers
    assert Path(answer["picture"]) == PICTURE.absolute()
    with Image.open(PICTURE) as image:
        assert image.size == (800, 800)


def test_errors_that_are_not_known_have_no_line() -> None:
    stopped = {"laps": 0, "distance_m": 0.3, "duration_s": 1.5, "cross_track_rms_m": None}
    assert tracking_lines(stopped) == ["  driven      0 laps, 0.300 m in 1.5 s"]


def test_a_picture_that_cannot_be_drawn_changes_nothing_but_is_told(
    daemon: None, cli: Cli, tmp_path: Path
) -> None:
    other = tmp_path / "other"
    other.write_text("of another user")
    PICTURE.symlink_to(other)
    ran = cli("drive", "square", "--wait", "--json")
    assert ran.exit_code == 0
    assert ran.summary["picture"] is None
    assert "no path.png was drawn" in ran.err
    assert other.read_text() == "of another user"


@pytest.fixture
def daemon_that_ramps_slowly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Set it before the daemon starts, which inherits it."""
    monkeypatch.setenv("FAKE_GENTLE", "1")


@pytest.fixture
def waiting(daemon: None, spawn: Spawn) -> Spawn:
    """Start a drive with --wait."""

    def begin(*options: str) -> subprocess.Popen[str]:
        process = spawn("drive", "square", "--laps", "0", "--wait", *options)
        while mode() != "MOVING":
            assert process.poll() is None
        return process

    return begin


@pytest.mark.parametrize(
    ("number", "options"), [(signal.SIGINT, ()), (signal.SIGTERM, ("--json",)), (signal.SIGHUP, ())]
)
def test_a_drive_that_is_waited_for_ends_with_its_command(
    number: int, options: tuple[str, ...], waiting: Spawn
) -> None:
    process = waiting(*options)
    process.send_signal(number)
    out, err = process.communicate(timeout=30)
    assert err.startswith(
        "robotctl: stopping the robot (Ctrl-C again: emergency stop)\n"
        "robotctl: Mode changed to IDLE\n"
    )
    assert process.returncode == 130
    if options:
        answer = json.loads(out)
        assert (answer["laps"], answer["error"]["kind"]) == (0, "interrupted")
    else:
        assert out.startswith("  driven      0 laps")
        assert err.count("\n") == 2
    assert mode() == "IDLE"


def test_a_second_ctrl_c_is_the_emergency_stop_and_a_closing_terminal_is_not(
    daemon_that_ramps_slowly: None, waiting: Spawn
) -> None:
    process = waiting()
    process.send_signal(signal.SIGHUP)
    assert "Ctrl-C again" in line_of(process.stderr)
    until(lambda: mode() == "IDLE")
    process.send_signal(signal.SIGHUP)
    process.send_signal(signal.SIGTERM)
    assert process.poll() is None
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 130
    assert err.endswith("Mode changed to EMERGENCY_STOP (release it with: robotctl reset)\n")
    assert mode() == "EMERGENCY_STOP"


def test_a_second_ctrl_c_straight_after_the_first_is_the_emergency_stop_and_a_third_changes_nothing(
    daemon: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted_call(robot: str, method: str, params: Any, **options: Any) -> Any:
        signal.raise_signal(signal.SIGINT)
        return call(robot, method, params, **options)

    ended: DriveAnswer = {"message": "", "mode": "IDLE"}
    driving = Background(lambda: ended)
    driving.start()
    monkeypatch.setattr(f"{DRIVING}.call", interrupted_call)
    assert "EMERGENCY_STOP" in str(stop_drive("robot", driving))
    assert mode() == "EMERGENCY_STOP"


def test_a_drive_is_stopped_when_the_reader_of_its_output_has_gone(waiting: Spawn) -> None:
    """An ssh connection without a terminal ends like this, without a signal."""
    process = waiting()
    assert process.stdout is not None
    process.stdout.close()
    process.wait(30)
    assert mode() == "IDLE"


def test_on_a_terminal_the_live_view_is_shown_while_a_drive_is_waited_for(
    daemon: None, command: list[str]
) -> None:
    controller, terminal = pty.openpty()
    waiting = subprocess.Popen(
        [*command, "drive", "square", "--laps", "0", "--wait"],
        stdin=terminal,
        stdout=terminal,
        stderr=terminal,
        env=os.environ | {"TERM": "xterm"},
    )
    os.close(terminal)
    try:
        seen = ""
        while "robot  up" not in seen or "MOVING" not in seen:
            seen += os.read(controller, 65536).decode(errors="ignore")
    finally:
        waiting.send_signal(signal.SIGINT)
        with suppress(OSError):  # which is how the end of a terminal reads
            while data := os.read(controller, 65536):
                seen += data.decode(errors="ignore")
        assert waiting.wait(30) == 130
        os.close(controller)
    assert "stopping the robot (Ctrl-C again: emergency stop)" in seen
    assert mode() == "IDLE"


def test_the_command_line_knows_the_modes_of_the_kernel() -> None:
    names = {mode.name.lower().replace("_", "-"): mode.value for mode in Mode}
    assert names == MODES
    assert Mode.EMERGENCY_STOP == EMERGENCY_STOP_MODE


def started(work: Callable[[], dict[str, Any]]) -> Background[dict[str, Any]]:
    background = Background(work)
    background.start()
    return background


def test_the_work_ends_even_if_the_waiting_thread_is_interrupted_at_any_step() -> None:
    for step in count(1):
        release = threading.Event()

        def work(release: threading.Event = release) -> dict[str, Any]:
            release.wait()
            return {}

        working = started(work)

        def is_done(working: Background[dict[str, Any]] = working) -> bool:
            return working.is_done

        was_interrupted = interrupted_at(step, is_done)
        release.set()
        until(is_done)
        working.join(DEADLINE_S)
        assert not working.is_alive()
        if not was_interrupted:
            assert step > 1, "there was no step to interrupt"
            return


def interrupted_at(step: int, ask: Any) -> bool:
    """Call `ask` and interrupt it at a line or a return; return False if it has fewer of them."""
    left = step

    def trace(frame: FrameType, event: str, argument: object) -> Any:
        nonlocal left
        left -= event in ("line", "return")
        if left == 0:
            left = -1
            raise KeyboardInterrupt
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        ask()
    except KeyboardInterrupt:
        return True
    finally:
        sys.settrace(before)
    return False


def test_a_reason_that_cannot_be_kept_is_refused_and_delays_no_stop(daemon: None, cli: Cli) -> None:
    for reason in ("x" * 10_000, "a\nb", "\x1b[2J", "\u202etxt"):
        for words in (("set-mode", "moving"), ("drive", "square"), ("reset",)):
            ran = cli(*words, "--reason", reason)
            assert (ran.exit_code, mode()) == (2, "IDLE")
            assert "--reason" in ran.err
        with pytest.raises(UsageError, match=r"reason: .* without control characters"):
            call("robot", "set_mode", {"mode": 0, "source": "test", "reason": reason})
        stopped = cli("estop", "--reason", reason)
        assert (stopped.exit_code, mode()) == (2, "EMERGENCY_STOP")
        assert "was stopped, but the reason was left out: --reason" in stopped.err
        assert cli("reset").exit_code == 0


def test_estop_of_one_names_the_others_that_move_and_all_stops_them(daemon: None, cli: Cli) -> None:
    assert cli("start", "--robot", "r2").exit_code == 0
    for robot in ("robot", "r2"):
        assert cli("set-mode", "moving", "--robot", robot).exit_code == 0
    stopped = cli("estop")
    assert "still MOVING: r2 (all robots: robotctl estop --all)" in stopped.out
    assert cli("estop", "--json").summary["others_moving"] == ["r2"]
    listed = {each["robot"]: each for each in cli("ps", "--json").summary["robots"]}
    assert {name: each["mode"] for name, each in listed.items()} == {
        "r2": "MOVING",
        "robot": "EMERGENCY_STOP",
    }
    assert listed["r2"]["pid"]
    assert listed["r2"]["recording"].endswith(".mcap")
    out = cli("estop", "--all", "--reason", "fire").succeeded()
    assert sorted(line.split(":")[0] for line in out.splitlines()) == ["r2", "robot"]
    assert call("r2", "status")["mode"] == "EMERGENCY_STOP"
    assert "EMERGENCY_STOP" in cli("ps").out
    assert "release it with: robotctl reset --robot r2" in cli("estop", "--robot", "r2").out


@pytest.mark.usefixtures("home")
def test_where_no_daemon_runs_ps_says_so_and_a_stop_of_all_fails(cli: Cli) -> None:
    assert cli("ps").out == "no daemon runs\n"
    assert cli("ps", "--json").summary == {"robots": []}
    assert cli("estop", "--all").exit_code == 3
