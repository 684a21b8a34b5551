"""`replay` with --check, --what-if and --resim, and with keys on a terminal."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from robotctl.recording.format.journal import JournalEntry
from robotctl.testing.drives import Written, drive, drive_requested, record
from tests.cli.conftest import Cli
from tests.support.bags import Line, odometry, status, write_bag
from tests.support.terminals import CODE, Terminal


@pytest.fixture(scope="module")
def written() -> list[Written]:
    return drive(1.0)


def diverging(written: list[Written]) -> list[Written]:
    """Return the same drive with another last command."""
    changed = list(written)
    position = max(
        i
        for i, each in enumerate(changed)
        if isinstance(each, JournalEntry) and each.name == "PublishTwist"
    )
    entry = changed[position]
    assert isinstance(entry, JournalEntry)
    changed[position] = entry._replace(data=entry.data.replace('"angular":0.0', '"angular":0.5'))
    return changed


def test_of_many_checks_the_gravest_decides_the_exit_code(cli: Cli, written: list[Written]) -> None:
    record(Path("recordings/a"), written)
    Path("recordings/b").mkdir()
    Path("recordings/b/b_0.mcap").write_bytes(b"no recording")
    ran = cli("replay", "recordings", "--check", "--json")
    ran.failed(6)
    verdicts = [each["verdict"] for each in ran.summary["recordings"]]
    assert verdicts == ["same", "incomplete"]
    record(Path("recordings/c"), diverging(written))
    cli("replay", "recordings", "--check").failed(
        7, "1 of 3 recordings would be decided differently"
    )


@pytest.mark.usefixtures("wide_terminal")
def test_a_divergence_is_told_with_what_led_to_it(cli: Cli, written: list[Written]) -> None:
    record(Path("run"), diverging(written))
    ran = cli("replay", "run", "--check")
    ran.failed(7, out="before MOVING, driving a square, command 0.")
    ran.failed(7, out='event Tick {"t_ns":')
    ran.failed(7, out="differs twist.angular: recorded 0.5, decided 0.0")
    assert max(map(len, ran.out.splitlines())) <= 80
    found = cli("replay", "run", "--check", "--json").summary["recordings"][0]["divergence"]
    assert found["mode"] == "MOVING"
    assert found["state"]["drive"]["pattern"]["kind"] == "square"


def test_others_in_a_glob_are_skipped_with_a_line_each(cli: Cli, written: list[Written]) -> None:
    record(Path("recordings/a"), written)
    Path("recordings/README").write_text("where recordings go\n")
    Path("recordings/notes").mkdir()
    Path("recordings/notes/path.png").touch()
    os.mkfifo("recordings/pipe")
    glob = sorted(map(str, Path("recordings").iterdir()))
    ran = cli("replay", *glob, "--check")
    assert (ran.exit_code, ran.err) == (0, "")
    assert ran.out.splitlines()[2:] == [
        f"skipped     recordings/{name}: not a recording" for name in ("README", "notes", "pipe")
    ]
    answer = cli("replay", *glob, "--check", "--json").summary
    assert answer["skipped"] == [f"recordings/{name}" for name in ("README", "notes", "pipe")]
    assert len(answer["recordings"]) == answer["same"] == 1


def test_what_may_be_a_recording_is_not_skipped(cli: Cli, written: list[Written]) -> None:
    record(Path("whole"), written)
    Path("torn.mcap").write_bytes(b"nothing")
    Path("packed.mcap.zstd").write_bytes(b"nothing")
    Path("bag").mkdir()
    Path("bag/metadata.yaml").touch()
    names = ("torn.mcap", "bag", "nowhere", "packed.mcap.zstd")
    ran = cli("replay", "whole", *names, "--check")
    assert ran.exit_code == 6
    for name in names:
        assert f"incomplete  {name}\n" in ran.out


def test_a_recording_under_another_name_is_known_by_its_first_bytes(
    cli: Cli, written: list[Written]
) -> None:
    (file,) = record(Path("whole"), written).glob("*.mcap")
    file.rename("renamed.bin")
    record(Path("other"), written)
    assert cli("replay", "other", "renamed.bin", "--check").out.count("same ") == 2


@pytest.fixture(scope="module")
def square() -> list[Written]:
    return drive(23.0, requests=[drive_requested(laps=1)])


@pytest.mark.usefixtures("wide_terminal")
def test_an_open_loop_says_that_the_robot_does_not_react(cli: Cli, square: list[Written]) -> None:
    record(Path("run"), square)
    out = cli("replay", "run", "--what-if", "tracking.k_y=8").succeeded(
        "The robot does not react here", "tracking.k_y                        20.0             8"
    )
    assert max(map(len, out.splitlines())) <= 80
    found = cli("replay", "run", "--what-if", "tracking.k_y=8", "--json").summary
    assert found["recordings"][0]["angular_rps"]["max"] > 0.0


def test_a_closed_loop_shows_the_error_before_and_after(cli: Cli, square: list[Written]) -> None:
    record(Path("run"), square)
    command = ("replay", "run", "--resim", "--what-if", "sim.lag_s=0.3")
    out = cli(*command).succeeded()
    (header,) = [line for line in out.splitlines() if "drive 1" in line]
    assert header.split() == ["drive", "1", "recorded", "simulated", "what", "if"]
    (rms,) = [line for line in out.splitlines() if "off track RMS" in line]
    _, simulated, other = map(float, rms.split("[m]")[1].split())
    assert other > simulated
    found = cli(*command, "--json").summary["recordings"][0]["drives"][0]
    assert found["what_if"]["cross_track_rms_m"] == pytest.approx(other, abs=1e-4)


def test_a_wrong_key_is_wrong_usage(cli: Cli, square: list[Written]) -> None:
    record(Path("run"), square)
    for setting in ("tracking.k=8", "tracking.k_y=nan", "sim.lag_s=1"):
        assert cli("replay", "run", "--what-if", setting).exit_code == 2
    assert cli("replay", "run", "--check", "--resim").exit_code == 2


def test_settings_may_stand_one_behind_the_other(cli: Cli, square: list[Written]) -> None:
    record(Path("run"), square)
    out = cli(
        "replay", "run", "--what-if", "tracking.k_y=8", "tracking.k_x=2", "--json"
    ).succeeded()
    assert set(json.loads(out)["recordings"][0]["settings"]) == {*("tracking.k_y", "tracking.k_x")}
    assert cli("replay", "--what-if", "tracking.k_y=8", "tracking.k_x=2").exit_code == 2


def test_an_option_that_says_how_to_play_is_refused(cli: Cli, square: list[Written]) -> None:
    record(Path("run"), square)
    for mode in ("--check", "--resim", "--what-if tracking.k_y=8"):
        cli("replay", "run", *mode.split(), "--rate", "2").failed(2, "--rate is only for playing")


def straight_ahead(seconds: int) -> list[Line]:
    """Return the messages at 10 Hz of a robot that drives straight ahead."""
    return [status(0, 1), *(odometry(n * 100.0, n * 0.01) for n in range(10 * seconds))]


@pytest.fixture
def long_file(tmp_path: Path) -> Path:
    return write_bag(tmp_path / "run.mcap", straight_ahead(600))


@pytest.fixture
def terminal() -> Iterator[Callable[..., Terminal]]:
    started: list[Terminal] = []

    def start(*arguments: object, **options: Any) -> Terminal:
        started.append(Terminal(*arguments, **options))
        return started[-1]

    yield start
    for each in started:
        each.close()


def test_keys_pause_step_and_change_the_rate(terminal: Any, long_file: Path) -> None:
    viewing = terminal("replay", long_file, "--draw-only", "--paused")
    viewing.until(r"0\.0 of 9 min 59 s +x1 +paused")
    viewing.press("n")
    viewing.press("n")
    viewing.until(r"0\.2 of .* paused")
    viewing.press("+")
    viewing.until(r"x1\.5 +paused")
    viewing.press("--")
    viewing.until(r"x0\.7 +paused")
    viewing.press(" ")
    viewing.until(r"\d\.\d of 9 min 59 s +x0\.7 +\r")
    assert not viewing.is_cooked()
    viewing.press("q")
    assert viewing.end() == 0
    assert viewing.is_cooked()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
def test_a_signal_ends_it_and_the_terminal_is_as_before(
    number: signal.Signals, terminal: Any, long_file: Path
) -> None:
    viewing = terminal("replay", long_file, "--draw-only")
    viewing.until("space pause")
    os.kill(viewing.pid, number)
    assert viewing.end() == 130
    assert viewing.is_cooked()


SHELL = """
import os, signal, sys, termios
signal.signal(signal.SIGTTOU, signal.SIG_IGN)
pid = os.fork()
if pid == 0:
    os.setpgid(0, 0)
    os.tcsetpgrp(0, os.getpid())
    signal.signal(signal.SIGTTOU, signal.SIG_DFL)
    os.execv(sys.executable, [sys.executable, "-c", *sys.argv[1:]])

def wait():
    _, status = os.waitpid(pid, os.WUNTRACED)
    os.tcsetpgrp(0, os.getpgrp())
    flags = termios.tcgetattr(0)[3]
    cooked = bool(flags & termios.ECHO) and bool(flags & termios.ICANON)
    said = "stopped" if os.WIFSTOPPED(status) else os.waitstatus_to_exitcode(status)
    print("SHELL:", said, cooked, flush=True)

wait()
sys.stdin.readline()
os.tcsetpgrp(0, pid)
os.kill(-pid, signal.SIGCONT)
wait()
"""
"""Job control of a shell for one command: it is stopped, continued by a line, and ends."""


def test_ctrl_z_returns_the_terminal_and_fg_takes_it_again(terminal: Any, long_file: Path) -> None:
    shell = terminal("replay", long_file, "--draw-only", program=(SHELL, CODE))
    shell.until(r"\d\.\d of 9 min")
    shell.press("\x1a")
    shell.until("SHELL: stopped True")
    shell.press("fg\n")
    shell.until("space pause")
    shell.press(" ")
    shell.until("paused")
    shell.press("q")
    shell.until("SHELL: 0 True")
