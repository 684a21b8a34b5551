"""A daemon with a blocked stderr drives, stops and ends normally."""

from __future__ import annotations

import os
import re
import signal
import time

import pytest

from robotctl.ipc.client import Client
from tests.support.waiting import DEADLINE_S, until
from tests.support.world import World

STOP_WITHIN_S = 10.0
"""The log stays blocked far longer: however busy the machine is, the stop did not wait for it."""


def count_of(client: Client, topic: str) -> int:
    topics = client.call("status")["topics"]
    return next((int(entry["count"]) for entry in topics if entry["name"] == topic), 0)


def test_a_blocked_log_delays_neither_the_stop_nor_the_zeros(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    while True:
        try:
            os.write(writing, b"-" * 4096)
        except BlockingIOError:
            break
    os.set_blocking(writing, True)
    process = world.spawn("start", "--foreground", "--sim", "--drive", "circle", stderr=writing)
    os.close(writing)
    for name in ("XDG_RUNTIME_DIR", "XDG_STATE_HOME"):
        monkeypatch.setenv(name, world.environment[name])
    assert process.stdout is not None
    assert '"ready": true' in process.stdout.readline()
    with Client("robot") as client:
        for number in range(1500):  # more than the queue holds
            client.call("mark", {"text": f"{number} {'x' * 990}", "source": "test"})
        assert client.call("status")["mode"] == "MOVING"
        asked = time.monotonic()
        assert client.call("set_mode", {"mode": 3, "source": "test"})["mode"] == "EMERGENCY_STOP"
        assert time.monotonic() - asked < STOP_WITHIN_S
        sent = count_of(client, "/cmd_vel")
        until(lambda: count_of(client, "/cmd_vel") > sent + 50)
    process.send_signal(signal.SIGINT)
    with open(reading, "rb") as pipe:
        text = pipe.read().decode().lstrip("-")
    assert process.wait(DEADLINE_S) == 0
    assert re.search(r"^log: \d+ lines are missing here", text, re.MULTILINE)
