"""`robotctl teleop` on terminals of its own, with the real daemon: nothing moves unless held."""

from __future__ import annotations

import os
import queue
import select
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path

import pytest

from robotctl.check.journal import read_effect, read_event
from robotctl.ipc.client import Client
from robotctl.ipc.method_names import HOLD
from robotctl.kernel.types import DriveRequested, HoldReceived, PublishTwist
from tests.support.terminals import CODE, Terminal
from tests.support.waiting import DEADLINE_S, until
from tests.support.world import Peer, World, entries_of, new_world

TELLS_RELEASES, IDENTIFY = b"\x1b[?u", b"\x1b[c"
ANSWERS = {TELLS_RELEASES: b"\x1b[?11u", IDENTIFY: b"\x1b[?62c"}


class AnsweringTerminal(Terminal):
    """A command line on a terminal that answers questions while `is_silent` is false.

    With `tells_releases` it knows the kitty keyboard protocol; the test sends the keys.
    """

    def __init__(
        self,
        *arguments: object,
        tells_releases: bool,
        program: tuple[str, ...] = (CODE,),
        environment: Mapping[str, str] = os.environ,
    ) -> None:
        super().__init__(*arguments, program=program, environment=environment)
        self.is_silent = False
        self._known = {TELLS_RELEASES, IDENTIFY} if tells_releases else {IDENTIFY}
        self._drawn: queue.Queue[bytes] = queue.Queue()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._answer)
        self._thread.start()

    def end(self) -> int:
        code = super().end()
        self._thread.join(DEADLINE_S)  # it has read everything that the process drew
        while self._read(0.0):
            pass
        return code

    def hang_up(self) -> None:
        self._end_thread()
        super().hang_up()

    def close(self) -> None:
        self._end_thread()
        super().close()

    def _end_thread(self) -> None:
        self._ended.set()
        self._thread.join()

    def _read(self, seconds: float) -> bool:
        try:
            self.seen += self._drawn.get(timeout=seconds).decode(errors="replace")
        except queue.Empty:
            return False
        return True

    def _answer(self) -> None:
        rest = b""
        with suppress(OSError):  # the process has ended
            while not self._ended.is_set():
                if not select.select([self._file], [], [], 0.02)[0]:
                    continue
                data = os.read(self._file, 65536)
                self._drawn.put(data)
                rest += data
                for question in sorted(self._known):
                    if not self.is_silent:
                        os.write(self._file, ANSWERS[question] * rest.count(question))
                begun = rest[rest.rfind(b"\x1b") :]
                rest = begun if any(q.startswith(begun) and q != begun for q in ANSWERS) else b""


Sit = Callable[..., AnsweringTerminal]

W_DOWN, W_AGAIN, W_UP = (f"\x1b[119;1:{event}u" for event in (1, 2, 3))


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    """A robot for all of this module; at the end, no command outlived a silence."""
    with new_world() as made:
        made.ok("start", "--sim")
        until(lambda: made.status()["pose"] is not None and made.status()["battery"] is not None)
        yield made
        made.ok("stop")
        (file,) = made.recordings.glob("*/*.mcap")
        assert_nothing_outlived_a_silence(file)


def assert_nothing_outlived_a_silence(file: Path) -> None:
    heard_ns: int | None = None
    moved = 0
    for entry in entries_of(file):
        if entry.name in (HoldReceived.__name__, DriveRequested.__name__):
            event = read_event(entry)
            is_held = isinstance(event, HoldReceived) or (
                isinstance(event, DriveRequested) and event.course.held is not None
            )
            heard_ns = event.t_ns if is_held else None
        elif entry.name == PublishTwist.__name__ and heard_ns is not None:
            effect = read_effect(entry)
            assert isinstance(effect, PublishTwist)
            if effect.twist.linear or effect.twist.angular:
                moved += 1
                assert entry.t_ns - heard_ns < 125_000_000
    assert moved > 0


@pytest.fixture
def sit(world: World) -> Iterator[Sit]:
    """Return a function that starts teleop on a terminal."""
    started: list[AnsweringTerminal] = []

    def start(*arguments: str, tells_releases: bool = True) -> AnsweringTerminal:
        terminal = AnsweringTerminal(
            "teleop", *arguments, tells_releases=tells_releases, environment=world.environment
        )
        started.append(terminal)
        terminal.until("q quit")
        return terminal

    yield start
    for each in started:
        each.close()
    until(lambda: world.answer_here("lease", "status")["holder"] is None)
    until(lambda: not moves(world))


def moves(world: World) -> bool:
    return bool(world.status()["mode"] == "MOVING")


def until_let_go(
    world: World, press: Callable[[], None], *, release: Callable[[], None] = lambda: None
) -> None:
    """Press and release until the command ends the motion.

    On a busy machine the command may be late: then the daemon ends the motion before it.
    """

    def is_let_go() -> bool:
        until_fast(world, press)
        release()
        until(lambda: not moves(world))
        return bool(world.status()["mode_reason"] == "let go")

    until(is_let_go)


def until_fast(world: World, press: Callable[[], object]) -> None:
    """Wait until the robot is fast; press again where a busy machine was a silence."""

    pressed_s = 0.0

    def is_fast() -> bool:
        nonlocal pressed_s
        status = world.status()
        if status["mode"] != "MOVING" and time.monotonic() - pressed_s > 0.8:
            pressed_s = time.monotonic()
            press()
        return bool(status["velocity"]["linear"] > 0.1)

    until(is_fast)


@contextmanager
def repeating(terminal: Terminal, keys: str) -> Iterator[Callable[[], None]]:
    """Send keys as a terminal repeats them, during the block; what is yielded lets them rest."""
    ended, rests = threading.Event(), threading.Event()

    def send() -> None:
        while not ended.wait(0.4 if rests.is_set() else 0.03):
            rests.clear()
            terminal.press(keys)

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield rests.set
    finally:
        ended.set()
        thread.join()


def test_the_robot_ramps_down_when_the_key_is_released(world: World, sit: Sit) -> None:
    terminal = sit()
    assert "robotctl teleop (uid" in world.answer_here("lease", "status")["holder"]
    until_fast(world, lambda: terminal.press(W_UP + W_DOWN))
    assert world.status()["drive"]["what"] == "by hand"
    until_let_go(world, lambda: terminal.press(W_UP + W_DOWN), release=lambda: terminal.press(W_UP))
    terminal.press("\x1b[113;1:1u")
    assert terminal.end() == 0
    assert terminal.is_cooked()


def test_without_releases_nothing_moves_until_the_key_repeats(world: World, sit: Sit) -> None:
    terminal = sit(tells_releases=False)
    terminal.until("nothing moves until the key repeats")
    terminal.press("w")
    terminal.press("+")
    terminal.until(r"speed 0\.33 m/s")
    assert not moves(world)
    with repeating(terminal, "w") as rest:
        until_fast(world, rest)
    until(lambda: not moves(world))
    assert world.status()["mode_reason"] == "not held for 125 ms"
    terminal.press("q")
    assert terminal.end() == 0


@pytest.mark.parametrize("tells_releases", [True, False])
def test_what_is_pasted_moves_nothing(world: World, sit: Sit, tells_releases: bool) -> None:
    terminal = sit(tells_releases=tells_releases)
    for pasted in (W_DOWN + "forward wasd", "w" * 30):
        terminal.press(f"\x1b[200~{pasted}\x1b[201~")
    terminal.press("\x1b]52;c;wasd\x07" + ("forward wasd " if tells_releases else "w" * 3000))
    terminal.press("\x1b[43;1:1u")
    terminal.until(r"speed 0\.33 m/s")
    assert not moves(world)


def test_a_terminal_that_falls_silent_while_a_key_is_held_is_zero(world: World, sit: Sit) -> None:
    terminal = sit()
    terminal.until("a terminal that is silent for 125 ms is zero")
    with repeating(terminal, W_AGAIN):
        until_fast(world, lambda: terminal.press(W_UP + W_DOWN))
        terminal.is_silent = True
        until(lambda: not moves(world))
    assert world.status()["mode_reason"] == "not held for 125 ms"
    terminal.is_silent = False
    terminal.press(W_AGAIN)
    terminal.until(r"rad/s\s+(not held for|this command was stopped or slow)")
    assert not moves(world), "it must be pressed again"
    until_fast(world, lambda: terminal.press(W_UP + W_DOWN))


def test_a_key_that_does_not_repeat_is_let_go(world: World, sit: Sit) -> None:
    terminal = sit()
    until_let_go(world, lambda: terminal.press(W_UP + W_DOWN))
    terminal.until("let go: no key repeated")


def test_a_frozen_command_moves_nothing_and_goes_on_only_with_a_new_press(
    world: World, sit: Sit
) -> None:
    terminal = sit()
    until_fast(world, lambda: terminal.press(W_UP + W_DOWN))
    os.kill(terminal.pid, signal.SIGSTOP)
    until(lambda: not moves(world))
    assert world.status()["mode_reason"] == "not held for 125 ms"
    terminal.press(W_AGAIN * 20)
    os.kill(terminal.pid, signal.SIGCONT)
    terminal.until(r"rad/s\s+(not held for|this command was stopped)")
    assert not moves(world)
    until_fast(world, lambda: terminal.press(W_AGAIN + W_UP + W_DOWN))


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_a_command_that_ends_lets_go_and_returns_the_lease(
    number: int, world: World, sit: Sit
) -> None:
    terminal = sit()
    until_fast(world, lambda: terminal.press(W_UP + W_DOWN))
    os.kill(terminal.pid, number)
    code = terminal.end()
    until(lambda: not moves(world))
    if number != signal.SIGKILL:
        assert code == 130
        assert terminal.is_cooked()
        assert "\x1b[<u\x1b[?2004l" in terminal.seen


def test_a_terminal_that_closes_lets_go(world: World, sit: Sit) -> None:
    terminal = sit()
    until_fast(world, lambda: terminal.press(W_UP + W_DOWN))
    terminal.hang_up()
    until(lambda: not moves(world))
    until(lambda: os.waitpid(terminal.pid, os.WNOHANG)[0])


def test_ctrl_c_and_the_emergency_stop_work_where_the_terminal_sends_no_signals(
    world: World, sit: Sit
) -> None:
    terminal = sit()
    until_fast(world, lambda: terminal.press(W_UP + W_DOWN))
    terminal.press("\x1b[101;1:1u")
    until(lambda: world.status()["mode"] == "EMERGENCY_STOP")
    terminal.until("release it with: robotctl reset")
    terminal.press(W_UP + W_DOWN)
    terminal.until("EMERGENCY_STOP .*by robotctl teleop", again=W_UP + W_DOWN)
    world.ok("reset")
    assert not moves(world), "the key is still down"
    terminal.press("\x1b[99;5u")
    assert terminal.end() == 130
    assert terminal.is_cooked()


def test_another_stop_is_not_undone_by_a_key_that_is_still_down(world: World, sit: Sit) -> None:
    terminal = sit(tells_releases=False)
    with repeating(terminal, "w") as rest:
        until_fast(world, rest)
        assert world.here("set-mode", "idle").exit_code == 0
        terminal.until("requested by robotctl set-mode|not held for")
        assert not moves(world)


def test_it_needs_hands_and_a_robot_that_stands(world: World) -> None:
    world.here("teleop").failed(2, "needs a terminal")
    world.ok("drive", "circle")
    terminal = Terminal("teleop", environment=world.environment)
    try:
        terminal.until("the robot is MOVING")
        assert terminal.end() == 4
    finally:
        terminal.close()
    world.ok("set-mode", "idle")


def test_a_connection_that_is_lost_is_silence(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    world.enter(monkeypatch)
    params = {"linear_mps": 0.3, "angular_rps": 0.0, "source": "a test"}
    with Client("robot") as client:
        number = client.call(HOLD, params)["hold"]
        until(lambda: client.call(HOLD, {**params, "hold": number})["mode"] == "MOVING")
    until(lambda: not moves(world))
    assert world.status()["mode_reason"] == "not held for 125 ms"


def test_a_gamepad_steers_while_its_button_is_held_and_its_end_is_zero(
    world: World, sit: Sit
) -> None:
    with Peer(world) as peer:
        hold = partial(peer, "hold_gamepad", topic="/joy")

        def press() -> None:
            for pressed in (False, True):
                hold(pressed=pressed)
                time.sleep(0.05)

        hold(pressed=True)
        terminal = sit("--joy", "joy")
        terminal.until("let go of button 4 of /joy first")
        assert not moves(world), "the button was down before"
        hold(pressed=False)
        terminal.until(r"and steer\s")
        until_let_go(world, press, release=partial(hold, pressed=False))
        until_fast(world, press)
    until(lambda: not moves(world))
    assert world.status()["mode_reason"] == "not held for 125 ms"
    terminal.until("nothing is heard on /joy")


@pytest.mark.parametrize(("limit", "hands"), [(5, ()), (9, ()), (12, ("--joy", "joy"))])
def test_too_few_open_files_end_it_with_one_sentence(
    world: World, limit: int, hands: tuple[str, ...]
) -> None:
    code = f"import resource as r; r.setrlimit(r.RLIMIT_NOFILE, ({limit}, {limit})); {CODE}"
    terminal = AnsweringTerminal(
        *("teleop", *hands), tells_releases=True, program=(code,), environment=world.environment
    )
    try:
        terminal.until(r"robotctl: too many open files: raise the limit \(ulimit -n\)\s")
        assert terminal.end() == 1
    finally:
        terminal.close()


def test_a_speed_or_an_axis_that_cannot_be_is_refused(world: World) -> None:
    for words in ("--speed nan", "--axes 1", "--axes a,b", "--button 64"):
        assert world.here("teleop", "--joy", "joy", *words.split()).exit_code == 2
