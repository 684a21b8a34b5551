"""The executor needs no other part of robotctl, and is loaded on first use only.

An executor refuses a platform whose middleware cannot wake the loop.
"""

from __future__ import annotations

import ctypes
import os
import struct
from collections.abc import Callable
from enum import Enum
from subprocess import CompletedProcess
from typing import Any

import pytest

import robotctl.ros
from robotctl.ros import AsyncioExecutor, executor
from robotctl.ros.executor import UnsupportedPlatform, announcements, raw_tap
from tests.ros.conftest import RunPython
from tests.support.waiting import DEADLINE_S

IMPORTED = """
import sys
{statement}
print(*sorted(name for name in sys.modules if name.split(".")[0] in ("robotctl", "rclpy")))
"""


def imported_by(run_python: RunPython, statement: str) -> set[str]:
    ended = run_python(IMPORTED.format(statement=statement))
    assert ended.returncode == 0, ended.stderr
    return set(ended.stdout.split())


def test_the_executor_needs_nothing_of_robotctl_but_its_own_parts(run_python: RunPython) -> None:
    names = imported_by(run_python, "from robotctl.ros import AsyncioExecutor, RawTap, Ticker")
    around = {"robotctl", "robotctl.ros", "robotctl.ros.executor"}
    own = {name for name in names if name.startswith("robotctl")}
    assert around < own
    assert {name for name in own - around if not name.startswith("robotctl.ros.executor.")} == set()


def test_the_package_and_the_ticker_are_imported_without_rclpy(run_python: RunPython) -> None:
    assert imported_by(run_python, "import robotctl.ros") == {"robotctl", "robotctl.ros"}
    names = "Tick, Ticker, RclCallFailed, UnsupportedPlatform"
    assert "rclpy" not in imported_by(run_python, f"from robotctl.ros.executor import {names}")


def test_every_name_of_the_face_is_there_and_in_the_other_face_the_same() -> None:
    named = {name: getattr(executor, name) for name in executor.__all__}
    assert len(named) == len(executor.__all__)
    for name in robotctl.ros.__all__:
        assert getattr(robotctl.ros, name) is named[name]


@pytest.fixture
def unproven(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robotctl.ros.executor.announcements._passed", False)


async def open_and_close(context: Any) -> None:
    async with AsyncioExecutor(context):
        pass


async def test_a_platform_without_eventfd_is_refused(
    context: Any, unproven: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(os, "eventfd")
    with pytest.raises(UnsupportedPlatform, match="needs Linux with eventfd"):
        await open_and_close(context)


async def test_a_middleware_without_callbacks_is_refused(
    context: Any, unproven: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    unsupported = 3
    monkeypatch.setattr(announcements, "_setter", lambda _: lambda *_: unsupported)
    with pytest.raises(UnsupportedPlatform, match="set RMW_IMPLEMENTATION=rmw_fastrtps_cpp"):
        await open_and_close(context)


async def test_a_middleware_whose_callback_never_comes_is_refused(
    context: Any, unproven: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    harmless = ctypes.cast(ctypes.CDLL(None).getpid, ctypes.c_void_p).value
    monkeypatch.setattr(announcements, "_eventfd_write", lambda: harmless)
    monkeypatch.setattr("robotctl.ros.executor.announcements.TIMEOUT_S", 0.1)
    with pytest.raises(UnsupportedPlatform, match="did not announce a message to itself"):
        await open_and_close(context)


async def test_message_structures_of_another_ros_are_refused(
    context: Any, unproven: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    # As if the structure had one field less at its beginning.
    monkeypatch.setattr(raw_tap, "_MESSAGE_INFO", struct.Struct("@8xqqQQQ8s"))
    with pytest.raises(UnsupportedPlatform, match="not those of ROS 2 Jazzy"):
        await open_and_close(context)


def test_a_ros_without_the_function_is_named() -> None:
    class Newer(Enum):
        SIGNAL = ("librcl.so", "rcl_no_such_function")

    newer: Any = Newer.SIGNAL
    with pytest.raises(UnsupportedPlatform, match="this ROS has no rcl_no_such_function"):
        announcements.watch(newer, 0, 0)


NO_FILES = """
import asyncio, os, resource, rclpy
from contextlib import suppress
from std_msgs.msg import UInt64
from robotctl.ros import AsyncioExecutor

async def main():
    rclpy.init(args=[])
    reported = []
    async with AsyncioExecutor(on_exception=lambda e, w: reported.append((e, w))) as executor:
        node = rclpy.create_node("tested")
        executor.add_node(node)
        got = []
        node.create_subscription(UInt64, "early", lambda m: got.append(m.data), 10)
        publisher = node.create_publisher(UInt64, "early", 10)
        await asyncio.sleep(0)
        limit = max(map(int, os.listdir("/proc/self/fd"))) + 1
        hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
        resource.setrlimit(resource.RLIMIT_NOFILE, (limit, hard))
        filled = []
        with suppress(OSError):
            while True:
                filled.append(os.open(os.devnull, os.O_RDONLY))
        timer = node.create_timer(0.001, lambda: got.append("timer"))
        async with asyncio.timeout(30):
            while not reported:
                await asyncio.sleep(0.001)
        executor.wake()
        await asyncio.sleep(0.05)
        assert len(reported) == 1, reported
        assert isinstance(reported[0][0], OSError), reported
        assert "Timer" in reported[0][1], reported
        publisher.publish(UInt64(data=4))
        while got != [4]:
            await asyncio.sleep(0.001)
    node.destroy_node()
    rclpy.shutdown()
    print("survived")

asyncio.run(main())
"""


def test_an_entity_that_gets_no_descriptor_is_reported_and_the_others_go_on(
    run_python: Callable[..., CompletedProcess[str]],
) -> None:
    ended = run_python(NO_FILES, timeout_s=DEADLINE_S)
    assert ended.stdout == "survived\n", ended.stderr


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'NoSuchExecutor'"):
        _ = robotctl.ros.NoSuchExecutor


async def test_a_32_bit_platform_is_refused(
    context: Any, unproven: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ctypes, "sizeof", lambda _: 4)
    with pytest.raises(UnsupportedPlatform, match="needs a 64-bit Python"):
        await open_and_close(context)
