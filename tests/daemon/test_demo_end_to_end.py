"""The demo with the real daemon: one lap, and the files it leaves."""

from __future__ import annotations

import os
import pty
import re
import select
import signal
from contextlib import suppress
from pathlib import Path

import pytest

from robotctl.recording import read_info
from tests.support.html_page import HtmlPage
from tests.support.waiting import DEADLINE_S, until
from tests.support.world import World, read_back


@pytest.mark.slow  # .ci/run runs the demo of the wheel
def test_the_demo_drives_a_lap_and_shows_what_was_recorded(world: World) -> None:
    world.source_another_ros()
    ran = world.robotctl("demo")
    assert ran.exit_code == 0, (ran, *map(Path.read_text, world.folder.glob("state/*/*/*.log")))
    assert ran.err.startswith("note: dropped another ROS (humble) from PYTHONPATH, LD_LIBRARY_PATH")
    out = ran.out
    folder = next(world.recordings.iterdir())
    topics = read_back(folder)
    world.robotctl("verify", str(folder)).succeeded()
    robot = re.search(r"starting a simulated robot: (demo_\d+)", out)
    assert robot is not None
    assert f"recording   {folder.relative_to(world.folder)}" in out
    assert "0 lost" in out
    heard = {name: messages for name, messages in topics.items() if messages}
    assert f"\n  and {len(topics) - len(heard)} more without messages\n" in out
    for name, messages in heard.items():
        assert re.search(rf"^ *{name} .* {len(messages)} ", out, re.MULTILINE), name
    assert len(topics[f"/{robot[1]}/odom"]) > 500
    figures = {
        name: [float(figure) for figure in re.findall(r"(\d+\.\d+) m", line)]
        for name, line in re.findall(r"^ *(off track|closure) +(.*)$", out, re.MULTILINE)
    }
    rms_m, worst_m = figures["off track"]
    assert 0.0 < rms_m < worst_m < 0.05
    assert figures["closure"][0] < 0.05
    png = (folder / "path.png").read_bytes()
    assert png.startswith(b"\x89PNG")
    following = out.split("next:\n")[1].splitlines()
    assert [line.split()[:2] for line in following] == [
        ["robotctl", "report"],
        ["robotctl", "replay"],
        ["robotctl", "start"],
    ]
    assert max(map(len, out[out.index("Hz\n") :].splitlines())) <= 80
    told = world.answer(*following[0].split()[1:])
    assert told["recordings"][0]["verdicts"] == {"replay --check": "same", "verify": "sealed"}
    assert told["recordings"][0]["figures"]["drives"] == 1
    assert HtmlPage((folder / "report.html").read_text()).wrong == []
    assert world.processes() == {}
    assert world.sockets() == []


@pytest.mark.parametrize(
    "number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)]
)
def test_an_interrupted_demo_leaves_a_valid_file_and_no_process(
    world: World, number: signal.Signals
) -> None:
    screen, terminal = pty.openpty()
    demo = world.spawn("demo", stdout=terminal)
    os.close(terminal)
    seen = b""
    while b"MOVING" not in seen:
        seen += _drawn(screen)
    demo.send_signal(number)
    with suppress(OSError):  # Linux reports so that no process has the terminal open
        while _drawn(screen):
            pass
    os.close(screen)
    _, err = demo.communicate(timeout=DEADLINE_S)
    assert demo.returncode == 130
    assert "recorded until then: recordings/demo_" in err
    until(lambda: not world.processes())
    info = read_info(world.recording)
    assert info.missing == ()
    assert info.indexed
    assert info.message_count >= 10


def _drawn(screen: int) -> bytes:
    """Return the demo's next output; unread output would block the demo."""
    assert select.select([screen], [], [], DEADLINE_S)[0], "the demo hangs"
    return os.read(screen, 65536)
