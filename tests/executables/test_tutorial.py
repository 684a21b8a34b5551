# mypy: disallow-untyped-calls=False
"""The test file of the tutorial, with real nodes instead of mocks, and its page."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from geometry_msgs.msg import Twist
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from robot_controller.msg import RobotStatus
from robot_controller.srv import SetMode

from robot_controller.velocity_publisher import VelocityPublisher
from robotctl.base.text import MODES
from robotctl.kernel.modes import Mode
from tests.support.waiting import until

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")


class Heard:
    """The tutorial's publisher in this process, and what another node hears of it."""

    def __init__(self, context: Context) -> None:
        self.publisher = VelocityPublisher(context)
        self.listener = Node("somebody_else", context=context)
        self.velocities: list[tuple[float, float]] = []
        self.listener.create_subscription(Twist, "cmd_vel", self._take, 100)
        self._executor = SingleThreadedExecutor(context=context)
        for node in (self.publisher, self.listener):
            self._executor.add_node(node)

    def _take(self, twist: Any) -> None:
        self.velocities.append((twist.linear.x, twist.angular.z))

    def until(self, condition: Callable[[], object]) -> None:
        """Run the callbacks of both nodes until the condition holds."""

        def holds() -> bool:
            self._executor.spin_once(timeout_sec=0.01)
            return bool(condition())

        until(holds)

    def close(self) -> None:
        """Destroy both nodes."""
        self._executor.shutdown()
        self.publisher.destroy_node()
        self.listener.destroy_node()


@pytest.fixture(scope="module")
def heard() -> Iterator[Heard]:
    """A publisher and a listener for the tests of this module."""
    from robotctl.base.domains import reserved_domain

    with reserved_domain() as number:
        context = Context()
        rclpy.init(context=context, domain_id=number)
        made = Heard(context)
        yield made
        made.close()
        context.destroy()


@pytest.mark.parametrize("velocity", [(0.0, 0.0), (0.5, 0.25), (-2.0, 2.0), (2.0, -2.0)])
def test_a_velocity_within_the_limits_passes_through(
    heard: Heard, velocity: tuple[float, float]
) -> None:
    heard.publisher.set_velocity(*velocity)
    heard.velocities.clear()
    heard.until(lambda: velocity in heard.velocities)


@pytest.mark.parametrize(
    ("asked", "limited"),
    [((5.0, 0.0), (2.0, 0.0)), ((-2.001, 0.5), (-2.0, 0.5)), ((0.1, 1e300), (0.1, 2.0))],
)
def test_a_velocity_outside_is_limited_and_said(
    heard: Heard,
    asked: tuple[float, float],
    limited: tuple[float, float],
    capfd: pytest.CaptureFixture[str],
) -> None:
    heard.publisher.set_velocity(*asked)
    linear, angular = limited
    assert f"limited to linear.x={linear}, angular.z={angular}" in capfd.readouterr().err
    heard.velocities.clear()
    heard.until(lambda: limited in heard.velocities)
    assert asked not in heard.velocities


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
