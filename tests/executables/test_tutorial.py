# mypy: disallow-untyped-calls=False
"""The test file of the tutorial, with real nodes instead of mocks, and its page.

The tutorial's executables do what they log, and end with a zero.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from operator import contains
from pathlib import Path
from typing import Any

import pytest
import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import LoggerLevel
from rcl_interfaces.srv import SetLoggerLevels
from rclpy.context import Context
from rclpy.node import Node
from robot_controller.msg import RobotStatus
from robot_controller.srv import SetMode

from robot_controller.velocity_publisher import VelocityPublisher
from robotctl.base.errors import UsageError
from robotctl.base.text import MODES
from robotctl.kernel.modes import Mode
from robotctl.ros.executables import mode_client
from robotctl.ros.executables.mode_client import mode_of
from robotctl.ros.executables.velocity_publisher import sweep_mps
from tests.support.lines import Ran, run_program
from tests.support.waiting import DEADLINE_S, until
from tests.support.world import installed

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")


def test_a_velocity_within_the_limits_passes_and_one_outside_is_limited_and_said(
    somebody: Node, capfd: pytest.CaptureFixture[str]
) -> None:
    publisher = VelocityPublisher(somebody.context)
    heard = commands_heard_by(somebody, "cmd_vel")
    for velocity in ((0.5, 0.25), (-2.0, 2.0), (2.0, -2.0), (0.0, 0.0)):
        publisher.set_velocity(*velocity)
        heard.clear()
        spin_until([somebody, publisher], partial(contains, heard, velocity))
    assert "limited" not in capfd.readouterr().err
    for asked, limited in (
        ((5.0, 0.0), (2.0, 0.0)),
        ((-2.001, 0.5), (-2.0, 0.5)),
        ((0.1, 1e300), (0.1, 2.0)),
    ):
        publisher.set_velocity(*asked)
        told = f"limited to linear.x={limited[0]}, angular.z={limited[1]}"
        assert told in capfd.readouterr().err
        heard.clear()
        spin_until([somebody, publisher], partial(contains, heard, limited))
        assert asked not in heard
    with pytest.raises(ValueError, match="finite"):
        publisher.set_velocity(float("nan"), 0.0)
    publisher.destroy_node()


@pytest.mark.parametrize(
    ("name", "number"), [("IDLE", 0), ("MOVING", 1), ("ERROR", 2), ("EMERGENCY_STOP", 3)]
)
def test_a_mode_has_one_name_and_one_number_everywhere(name: str, number: int) -> None:
    assert Mode[name].value == number
    assert getattr(RobotStatus, f"MODE_{name}") == number
    assert MODES[name.lower().replace("_", "-")] == number
    assert SetMode.Request(requested_mode=number).requested_mode == number


def test_there_are_no_other_modes() -> None:
    assert len(Mode) == len(MODES) == 4
    assert len([name for name in dir(RobotStatus) if name.startswith("MODE_")]) == 4


def test_every_file_that_the_page_names_for_a_duty_exists() -> None:
    """The last column of both tables tells where something is here."""
    sections = PAGE.split("\n## ")
    tables = [part for part in sections if part.startswith(("The package", "What you were"))]
    columns = [row.split("|")[-2] for table in tables for row in table.splitlines() if "|" in row]
    named = re.findall(r"`((?:robotctl|tests|msg|\.ci)/[\w./-]*)`", " ".join(columns))
    assert len(named) > 15
    assert [name for name in named if not (ROOT / name).exists()] == []


def test_the_tutorials_own_files_stand_where_it_has_them() -> None:
    rows = re.findall(r"^\| `(robot_controller/[a-z]\w+\.py|package\.xml)` \|", PAGE, re.MULTILINE)
    assert len(rows) == 5
    assert [name for name in rows if not (ROOT / name).exists()] == []


LATCHED = "refused in EMERGENCY_STOP: ask for IDLE first"


class Running:
    """An executable under way."""

    def __init__(self, log: Path, name: str, *arguments: str) -> None:
        self._log = log
        with log.open("w") as out:
            self._process = subprocess.Popen(
                [installed(name), *arguments],
                stdout=out,
                stderr=out,
                cwd=log.parent,
                env={**os.environ, "XDG_STATE_HOME": str(log.parent / "state")},
            )

    @property
    def lines(self) -> list[str]:
        """What it has logged, without severity, time and node."""
        return re.findall(
            r"^\[\w+\] \[[\d.]+\] \[[\w.]+\]: (.*)$", self._log.read_text(), re.MULTILINE
        )

    def says(self, text: str) -> None:
        """Wait until it has logged the line."""
        self.begins(text)
        assert text in self.lines, self._log.read_text()

    def begins(self, text: str) -> None:
        """Wait until it has logged a line that begins with the text."""

        def told() -> bool:
            return any(line.startswith(text) for line in self.lines)

        until(lambda: told() or self._process.poll() is not None)
        assert told(), self._log.read_text()

    @property
    def text(self) -> str:
        """All that it has printed."""
        return self._log.read_text()

    def wait(self) -> int:
        """Wait until it ends by itself, and return its exit code."""
        return self._process.wait(timeout=DEADLINE_S)

    def send(self, number: signal.Signals) -> None:
        """Send it a signal."""
        self._process.send_signal(number)

    def end(self, number: signal.Signals = signal.SIGINT) -> int:
        """Signal it, and return its exit code."""
        self._process.send_signal(number)
        code = self._process.wait(timeout=60)
        assert "Traceback" not in self._log.read_text()
        return code

    def close(self) -> None:
        """End it if it runs; killed, it would leave shared memory behind."""
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(timeout=DEADLINE_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
                raise


Start = Callable[..., Running]


@pytest.fixture
def start(tmp_path: Path, domain_id: int) -> Iterator[Start]:
    """Start executables; they end with the test."""
    running: list[Running] = []

    def begin(name: str, *arguments: str) -> Running:
        running.append(Running(tmp_path / f"{len(running)}.log", name, *arguments))
        return running[-1]

    yield begin
    for each in running:
        each.close()


@pytest.fixture
def somebody(domain_id: int) -> Iterator[Node]:
    """A node of somebody else."""
    context = Context()
    rclpy.init(context=context, domain_id=domain_id)
    made = Node("somebody_else", context=context)
    yield made
    made.destroy_node()
    context.destroy()


def client(*arguments: str) -> Ran:
    return run_program(installed("mode_client"), *arguments)


def commands_heard_by(node: Node, topic: str) -> list[tuple[float, float]]:
    """Subscribe to the commands; the list that is returned grows while the node spins."""
    heard: list[tuple[float, float]] = []

    def take(twist: Any) -> None:
        heard.append((twist.linear.x, twist.angular.z))

    node.create_subscription(Twist, topic, take, 100)
    return heard


def spin_until(nodes: list[Node], condition: Callable[[], object]) -> None:
    """Run the callbacks of the nodes until the condition holds."""
    executor = rclpy.executors.SingleThreadedExecutor(context=nodes[0].context)
    for each in nodes:
        executor.add_node(each)

    def holds() -> bool:
        executor.spin_once(timeout_sec=0.01)
        return bool(condition())

    until(holds)
    executor.shutdown()


def test_the_sweep_goes_in_exact_tenths_from_minus_2_to_2() -> None:
    speeds = [sweep_mps(number) for number in range(81)]
    assert [str(speed) for speed in speeds[:3]] == ["0.1", "0.2", "0.3"]
    assert (speeds[19], speeds[20], speeds[39]) == (2.0, 1.9, 0.0)
    assert (speeds[59], speeds[60], speeds[79], speeds[80]) == (-2.0, -1.9, 0.0, 0.1)
    assert all(len(str(abs(speed))) == 3 for speed in speeds)


def test_it_sweeps_after_4_s_of_zeros_alone_or_if_told_and_moves_no_robot_it_does_not_know(
    start: Start, somebody: Node
) -> None:
    guarded = commands_heard_by(somebody, "/guarded/cmd_vel")
    swept = commands_heard_by(somebody, "/told/cmd_vel")
    alone = start("velocity_publisher")
    careful = start("velocity_publisher", "--ros-args", "-r", "__ns:=/guarded")
    told = start("velocity_publisher", "--ros-args", "-r", "__ns:=/told", "-p", "sweep:=true")
    alone.says("Publishing: linear.x=0.3, angular.z=0.0")
    zero = "Publishing: linear.x=0.0, angular.z=0.0"
    speeds = [f"Publishing: linear.x={speed}, angular.z=0.0" for speed in (0.1, 0.2, 0.3)]
    assert alone.lines[:12] == ["Velocity Publisher Node started", *[zero] * 8, *speeds]
    assert alone.end() == 0
    assert alone.lines[-1] == "Shutting down ..."
    spin_until([somebody], lambda: (0.2, 0.0) in swept)
    assert told.end(signal.SIGTERM) == 0
    spin_until([somebody], lambda: swept[-1] == (0.0, 0.0))
    careful.says(
        "/somebody_else takes /guarded/cmd_vel and may be a robot: publishing zeros "
        "(sweep all the same: --ros-args -p sweep:=true)"
    )
    assert set(guarded) == {(0.0, 0.0)}


def test_the_odom_subscriber_tells_each_tenth_position_at_the_level_that_a_service_sets(
    start: Start, somebody: Node
) -> None:
    subscriber = start("odom_subscriber", "--log-level", "odom_subscriber:=warn")
    client = somebody.create_client(SetLoggerLevels, "/odom_subscriber/set_logger_levels")
    assert client.wait_for_service(DEADLINE_S)
    assert subscriber.lines == []
    wanted = [LoggerLevel(name="odom_subscriber", level=LoggerLevel.LOG_LEVEL_INFO)]
    done = client.call_async(SetLoggerLevels.Request(levels=wanted))
    spin_until([somebody], done.done)
    assert done.result().results[0].successful
    publisher = somebody.create_publisher(Odometry, "odom", 10)
    until(publisher.get_subscription_count)
    message = Odometry()
    message.pose.pose.position.x, message.pose.pose.position.y = 1.234, -0.5

    def told() -> bool:
        publisher.publish(message)
        return "Messages received: 20" in subscriber.lines

    until(told)
    position = "Position: x=1.23, y=-0.50, z=0.00"
    expected = [position, "Messages received: 10", position, "Messages received: 20"]
    assert subscriber.lines[:4] == expected
    assert subscriber.end() == 0


@pytest.mark.parametrize(
    ("text", "mode"),
    [
        *((mode.name, mode) for mode in Mode),
        *((str(mode.value), mode) for mode in Mode),
        ("moving", Mode.MOVING),
        ("emergency-stop", Mode.EMERGENCY_STOP),
        ("Emergency_Stop", Mode.EMERGENCY_STOP),
    ],
)
def test_a_mode_is_asked_for_in_any_spelling_or_by_number(text: str, mode: Mode) -> None:
    assert mode_of(text) is mode


@pytest.mark.parametrize("text", ["", "fly", "4", "-1", "1.0"])
def test_no_other_word_is_a_mode(text: str) -> None:
    with pytest.raises(UsageError, match="use IDLE, MOVING, ERROR, EMERGENCY_STOP, or 0 to 3"):
        mode_of(text)


def test_the_tutorials_calls_are_answered_by_one_service_that_leaves_moving_for_a_robot(
    start: Start, somebody: Node
) -> None:
    ignored = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as under nohup
    try:
        service = start("mode_service")
    finally:
        signal.signal(signal.SIGHUP, ignored)
    service.says("Mode Service Node started")
    service.send(signal.SIGHUP)
    second = start("mode_service")
    answers = [client("MOVING")]
    robot = somebody.create_subscription(Twist, "cmd_vel", lambda _: None, 10)
    service.begins("velocity commands are taken: back to IDLE")
    client("MOVING").failed(4, out="this service drives no robot: robotctl start does")
    somebody.destroy_subscription(robot)
    answers += [client(mode) for mode in ("idle", "3", "moving")]
    assert [answer.out for answer in answers] == [
        "success=True, message='Mode changed to MOVING', current_mode=1\n",
        "success=True, message='Mode changed to IDLE', current_mode=0\n",
        "success=True, message='Mode changed to EMERGENCY_STOP', current_mode=3\n",
        f"success=False, message={LATCHED!r}, current_mode=3\n",
    ]
    assert [answer.exit_code for answer in answers] == [0, 0, 0, 4]
    assert second.wait() == 4
    assert second.text == (
        "mode_service: /set_mode is served already: ask that one, or give this one another "
        "namespace or ROS domain\n"
    )
    assert service.end() == 0


def test_without_a_service_the_client_says_how_to_get_one(
    domain_id: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys.modules[mode_of.__module__], "SERVICE_S", 0.5)
    monkeypatch.setattr(sys, "argv", ["mode_client", "MOVING"])
    assert mode_client() == 3
    assert capsys.readouterr().err == (
        "mode_client: no service /set_mode within 0.5 s: start one: robotctl start, "
        "or: ros2 run robot_controller mode_service\n"
    )


@pytest.mark.parametrize(
    ("arguments", "domain", "text"),
    [
        (["-p", "sweep:=7"], "", "Invalid parameter value (7) for parameter. Reason: sweep is"),
        (["-r", "__ns:=a b"], "", "Couldn't parse remap rule: '-r __ns:=a b'"),
        ([], "kitchen", "ROS_DOMAIN_ID is 'kitchen': use 0 to 232"),
    ],
)
def test_a_wrong_argument_is_named_in_a_sentence(
    arguments: list[str], domain: str, text: str, monkeypatch: pytest.MonkeyPatch, domain_id: int
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", domain or str(domain_id))
    err = run_program(installed("velocity_publisher"), "--ros-args", *arguments).failed(2)
    assert "Traceback" not in err
    last = err.splitlines()[-1]  # rcl may say something before
    assert last.startswith("velocity_publisher: ")
    assert text in last


def test_the_mode_service_drives_and_records_nothing(start: Start) -> None:
    service = start("mode_service", "--ros-args", "-p", "config:=/a.yaml")
    assert service.wait() == 2
    assert service.text == (
        "mode_service: config: this node drives and records no robot: "
        "use: robotctl start --config FILE --recordings DIR\n"
    )


def test_a_node_of_our_own_answers_like_the_executable_and_names_its_robot(somebody: Node) -> None:
    from robot_controller.mode_service import ModeService

    told: list[Any] = []
    somebody.create_subscription(RobotStatus, "/r1/robot_status", told.append, 10)
    service = ModeService(somebody.context, namespace="/r1")
    assert service.request(1) == (True, "Mode changed to MOVING")
    assert service.request(3) == (True, "Mode changed to EMERGENCY_STOP")
    assert service.request(1) == (False, "refused in EMERGENCY_STOP: ask for IDLE first")
    spin_until([somebody, service], lambda: told and told[-1].robot_name == "r1")
    service.destroy_node()
