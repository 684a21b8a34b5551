"""A daemon without memory sends zeros, and ends with exit code 1 and a log line."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import pytest

from robotctl.daemon.control.inputs import Inputs
from robotctl.daemon.control.robot_report import RobotReport
from robotctl.daemon.recording.recorder_report import RecorderReport
from robotctl.daemon.supervisor import OUT_OF_MEMORY
from robotctl.errors import RobotctlError
from robotctl.kernel.patterns import PatternKind
from robotctl.ros.nodes.velocity_publisher import VelocityPublisher
from tests.support.waiting import loop_until
from tests.support.world import World, read_back

STILL = bytes(48)


@pytest.mark.parametrize(
    ("owner", "name"),
    [
        (RecorderReport, "sample"),  # a task
        (Inputs, "odometry"),  # a callback of ROS
        (VelocityPublisher, "publish"),  # an effect of the kernel
        (RobotReport, "path"),  # a request
    ],
)
async def test_without_memory_the_robot_stops_and_the_daemon_ends(
    in_process: Callable[..., Any],
    world: World,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    owner: Any,
    name: str,
) -> None:
    original, armed = getattr(owner, name), [False]
    failed: list[str] = []

    def fail(*args: Any, **kwargs: Any) -> Any:
        if armed[0] and len(failed) < 5:
            failed.append(name)
            raise MemoryError
        return original(*args, **kwargs)

    async def drive() -> None:
        async with in_process(drive=PatternKind.CIRCLE) as daemon:
            await daemon.until(lambda status: status["mode"] == "MOVING")
            armed[0] = True
            with suppress(RobotctlError):
                await daemon.ask("path")
            await loop_until(lambda: failed)

    monkeypatch.setattr(owner, name, fail)
    with pytest.raises(RobotctlError, match=OUT_OF_MEMORY):
        await drive()
    last = read_back(next(world.recordings.iterdir()))["/cmd_vel"][-1]
    assert last.data[4:] == STILL
    assert caplog.text.count("out of memory") < 5
    assert "Traceback" not in caplog.text
