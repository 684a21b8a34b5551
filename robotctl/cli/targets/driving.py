"""Wait for a drive, end it at an interruption, and hold the robot's lease."""

from __future__ import annotations

import os
import select
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from math import inf
from types import FrameType, TracebackType
from typing import Any, Final, Generic, Self, TypeVar

from robotctl.base.errors import Interrupted, RobotctlError
from robotctl.cli.targets.requests import request_source
from robotctl.ipc.answers import DriveAnswer, MessageAnswer
from robotctl.ipc.client import Client, call, command_for
from robotctl.ipc.method_names import END_DRIVE, LEASE_KEEP, LEASE_RELEASE, LEASE_TAKE, SET_MODE
from robotctl.ipc.protocol import EMERGENCY_STOP_MODE

T = TypeVar("T")


class Background(threading.Thread, Generic[T]):
    """A daemon thread that runs `work` and keeps its result."""

    # Not a future: a future's lock may stay locked if Ctrl-C interrupts one of its methods, and the
    # thread, which needs that lock, then never ends.

    def __init__(self, work: Callable[[], T]) -> None:
        super().__init__(daemon=True)
        self.is_done = False
        self._work = work
        self._returned: T
        self._raised: BaseException | None = None

    def run(self) -> None:
        """Run the work, and keep its result or its exception."""
        try:
            self._returned = self._work()
        except BaseException as error:  # noqa: BLE001 - `result` raises it again
            self._raised = error
        self.is_done = True

    def result(self) -> T:
        """Wait for the work, then return its result or raise its exception."""
        self.join()
        if self._raised is not None:
            raise self._raised
        return self._returned


@contextmanager
def interrupted_by(numbers: Iterable[signal.Signals]) -> Iterator[None]:
    """Raise KeyboardInterrupt at the signals `numbers`, unless they are ignored or handled.

    After the first such signal, all of them are ignored until the end of the block.
    """
    previous = {
        number: signal.getsignal(number)
        for number in numbers
        # nohup ignores SIGHUP on purpose
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler)
    }

    def interrupt(number: int, frame: FrameType | None) -> None:
        for other in previous:  # a terminal that closes sends several signals
            signal.signal(other, _ignore)
        raise KeyboardInterrupt

    try:
        for number in previous:
            signal.signal(number, interrupt)
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


@contextmanager
def ignoring(numbers: Iterable[signal.Signals]) -> Iterator[None]:
    """Ignore the signals `numbers` inside the `with` block."""
    previous = {number: signal.signal(number, _ignore) for number in numbers}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _ignore(number: int, frame: FrameType | None) -> None:
    """Handle a signal by doing nothing."""
    # Not SIG_IGN: children inherit it, and Python reports an error for a signal just before it.


CLOSING_SIGNALS: Final = (signal.SIGHUP, signal.SIGTERM)
"""The signals of a terminal that closes and of a session that ends."""

POLL_S: Final = 0.05
"""The period of the checks for the end of a drive, or for a lease [s]."""

REPORT_DEADLINE_S: Final = 2.0
"""The timeout of a drive's report after its end [s]."""

_STDOUT: Final = 1


def wait_while_stdout_open(driving: Background[DriveAnswer], at_most_s: float = inf) -> None:
    """Wait until the drive ends or `at_most_s` seconds have passed, while stdout is open.

    Raises:
        KeyboardInterrupt: The reader of stdout has closed the pipe.
    """
    poll = select.poll()
    poll.register(_STDOUT, 0)
    end = time.monotonic() + at_most_s
    while (
        not driving.is_done and time.monotonic() < end
    ):  # polls, because an interrupted join would mark the thread as ended
        if any(found & (select.POLLERR | select.POLLHUP) for _, found in poll.poll(POLL_S * 1000)):
            raise KeyboardInterrupt  # an ssh connection without a terminal ends without a signal


def stop_drive(robot: str, driving: Background[DriveAnswer]) -> Interrupted:
    """Ramp the robot down, and return the error to raise, with the numbers of the drive.

    Another Ctrl-C latches the emergency stop.

    Raises:
        RobotctlError: The daemon could not be reached, or refused to stop the robot.
    """
    params: dict[str, Any] = {"source": request_source("drive")}
    try:
        with ignoring(CLOSING_SIGNALS):
            with suppress(OSError):  # the terminal may be gone
                note = "robotctl: stopping the robot (Ctrl-C again: emergency stop)"
                print(note, file=sys.stderr, flush=True)
            message = call(robot, END_DRIVE, params, deadline_s=None)["message"]
    except KeyboardInterrupt:
        with ignoring((signal.SIGINT, *CLOSING_SIGNALS)):
            stop = params | {"mode": EMERGENCY_STOP_MODE}
            message = call(robot, SET_MODE, stop)["message"]
            message += f" (release it with: {command_for(robot, 'reset')})"
    return Interrupted(message, answer=_drive_report(driving))


def _drive_report(driving: Background[DriveAnswer]) -> Mapping[str, Any]:
    """Return the numbers of the ended drive, or {} if the daemon does not report them in time."""
    until = time.monotonic() + REPORT_DEADLINE_S
    while not driving.is_done:
        if time.monotonic() > until:
            return {}
        time.sleep(POLL_S)
    try:
        return driving.result()
    except RobotctlError as error:
        return error.answer


KEEP_S = 0.2
"""The period in which this process renews its lease [s]."""


class HeldLease:
    """Holds the robot's lease in a `with` block: no other client can start a motion.

    If this process freezes or is killed, the lease ends in about a second, and the robot ramps
    down.

    Raises:
        Refused: At the start of the block, another client holds the lease, or the robot moves.
        NoDaemon: At the start of the block, no daemon runs.
    """

    def __init__(self, robot: str, command: str, reason: str = "") -> None:
        """`command` is the command of robotctl that holds the lease."""
        self.token = os.urandom(16).hex()
        """The parameter `lease` of each request that acts for the holder."""
        self._robot = robot
        self._source = request_source(command)
        params = {"token": self.token, "source": self._source, "reason": reason}
        self._holding: Background[MessageAnswer] = Background(
            partial(call, robot, LEASE_TAKE, params, deadline_s=None)
        )
        self._ended = threading.Event()

    @property
    def is_over(self) -> bool:
        """Whether the lease has ended."""
        return self._holding.is_done

    def result(self) -> MessageAnswer:
        """Wait for the end of the lease, and return the daemon's answer.

        Raises:
            RobotctlError: The lease was refused or lost.
        """
        return self._holding.result()

    def __enter__(self) -> Self:
        """Acquire the lease."""
        try:
            self._holding.start()
            with Client(self._robot) as client:
                while not client.call(LEASE_KEEP, {"token": self.token})["yours"]:
                    if self.is_over:
                        self.result()
                    time.sleep(POLL_S)
            Background(self._keep).start()
        except BaseException:
            self._release()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._release()

    def _keep(self) -> None:
        with Client(self._robot) as client:
            while not self._ended.wait(KEEP_S):
                if not client.call(LEASE_KEEP, {"token": self.token})["yours"]:
                    return

    def _release(self) -> None:
        self._ended.set()
        if not self.is_over and self._holding.ident is not None:
            params = {"token": self.token, "source": self._source}
            # The end of the connection releases the lease, too; `result` reports what fails here.
            with ignoring((signal.SIGINT, *CLOSING_SIGNALS)), suppress(RobotctlError):
                call(self._robot, LEASE_RELEASE, params)
