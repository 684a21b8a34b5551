"""Other nodes receive the recorded messages, byte for byte and in order."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from tests.support.bags import (
    LATCHED,
    SENSOR,
    STRING,
    TWIST,
    Line,
    data,
    in_order,
    padded,
    talk,
    twist,
    write_bag,
)

Until = Callable[[Callable[[], object]], Awaitable[None]]
LATCHED_QOS = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
SENSOR_QOS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)


@pytest.mark.parametrize("rate", ["1", pytest.param("max", marks=pytest.mark.slow)])
async def test_every_message_is_published_again_with_its_bytes_in_its_order(
    rate: str, tmp_path: Path, listener: Any, replay: Any, until: Until
) -> None:
    alpha, beta = talk("/alpha", 200), talk("beta", 150, 7.0)
    sensor = talk("/sensor", 100, 10.0, qos=SENSOR)
    commands = [Line("/cmd_vel", TWIST, n * 10.0, twist(n / 100)) for n in range(100)]
    file = write_bag(tmp_path / "run.mcap", in_order(alpha, beta, sensor, commands))
    for topic in ("/alpha", "/beta"):
        listener.listen(topic, STRING)
    listener.listen("/sensor", STRING, SENSOR_QOS)
    ran = await replay(file, "--rate", rate, "--json")
    assert ran.exit_code == 0, ran.err
    await until(lambda: len(listener.heard["/sensor"]) == 100)
    assert listener.heard == {
        "/alpha": data(alpha),
        "/beta": data(beta),
        "/sensor": data(sensor),
    }
    assert ran.summary["sent"] == 450
    assert ran.summary["withheld"] == {"/cmd_vel": 100}
    assert (ran.summary["failed"], ran.summary["skipped"]) == (0, {})
    assert (ran.summary["timing_error_us"] is None) == (rate == "max")


@pytest.mark.slow
async def test_a_subscriber_that_reads_slowly_gets_everything_at_full_speed(
    tmp_path: Path, listener: Any, replay: Any, until: Until
) -> None:
    lines = talk("/flood", 12_000, 0.01)
    file = write_bag(tmp_path / "run.mcap", lines)
    listener.listen("/flood", STRING, 20)
    ran = await replay(file, "--rate", "max", "--json")
    assert ran.summary["sent"] == 12_000
    assert ran.summary["failed"] == 0


async def test_the_recorded_gaps_are_kept(tmp_path: Path, replay: Any) -> None:
    file = write_bag(tmp_path / "run.mcap", talk("/alpha", 3, 200.0))
    ran = await replay(file, "--rate", "2", "--json")
    assert ran.summary["played_s"] == pytest.approx(0.4)
    assert 0 <= ran.summary["timing_error_us"]["p50"] <= ran.summary["timing_error_us"]["max"]


async def test_topics_exclude_offset_and_duration_choose_what_is_played(
    tmp_path: Path, listener: Any, replay: Any, until: Until
) -> None:
    alpha, beta, gamma = (talk(f"/{name}", 100, 10.0) for name in ("alpha", "beta", "gamma"))
    file = write_bag(tmp_path / "run.mcap", in_order(alpha, beta, gamma))
    for topic in ("/alpha", "/beta", "/gamma"):
        listener.listen(topic, STRING)
    ran = await replay(
        file, "--topics", "alpha,/beta", "--exclude", "/beta", "--start-offset", "0.2",
        "--duration", "0.3", "--rate", "5", "--json",
    )  # fmt: skip
    assert ran.exit_code == 0, ran.err
    await until(lambda: len(listener.heard["/alpha"]) == ran.summary["sent"])
    assert listener.heard == {"/alpha": data(alpha[20:51]), "/beta": [], "/gamma": []}


async def test_a_loop_begins_again_until_ctrl_c_which_takes_the_publishers_away(
    tmp_path: Path, listener: Any, start: Any, until: Until
) -> None:
    lines = talk("/alpha", 4, 10.0)
    file = write_bag(tmp_path / "run.mcap", lines)
    listener.listen("/alpha", STRING)
    running = start(file, "--loop", "--json")
    heard = listener.heard["/alpha"]
    await until(lambda: len(heard) > 9)
    assert heard[:8] == data(lines) * 2
    running.interrupt()
    ran = await running.end()
    assert ran.exit_code == 130
    assert ran.err == ""
    assert ran.summary["interrupted"]
    await until(lambda: listener.node.count_publishers("/alpha") == 0)


async def test_a_replay_does_not_outlive_the_command(
    tmp_path: Path, listener: Any, start: Any, until: Until
) -> None:
    file = write_bag(tmp_path / "run.mcap", talk("/alpha", 4, 10.0))
    listener.listen("/alpha", STRING)
    running = start(file, "--loop")
    await until(lambda: listener.heard["/alpha"])
    running.kill()
    await until(lambda: listener.node.count_publishers("/alpha") == 0)


async def test_what_was_latched_before_the_offset_is_latched_again(
    tmp_path: Path, listener: Any, start: Any, until: Until
) -> None:
    latched = talk("/map", 3, 10.0, qos=LATCHED)
    file = write_bag(tmp_path / "run.mcap", in_order(latched, talk("/alpha", 100, 100.0)))
    listener.listen("/alpha", STRING)
    start(file, "--start-offset", "1")
    await until(lambda: listener.heard["/alpha"])
    listener.listen("/map", STRING, LATCHED_QOS)  # late
    await until(lambda: listener.heard["/map"])
    assert listener.heard["/map"] == data(latched[-1:])


@pytest.mark.parametrize("bag", [pytest.param("talker", marks=pytest.mark.slow), "split_bag"])
async def test_a_folder_of_rosbag2_is_played_in_order(
    bag: str, listener: Any, replay: Any, until: Until
) -> None:
    from robotctl.recording import read_messages

    folder = next(
        (each / bag for each in (Path(__file__).parents[3] / "shared" / "samples").glob("rosbag2")),
        None,
    )
    if folder is None:
        pytest.skip("the sample recordings are not here")
    recorded: dict[str, list[bytes]] = {}
    for message in read_messages(folder):
        if message.type_name == STRING:
            recorded.setdefault(f"/{message.topic.lstrip('/')}", []).append(padded(message.data))
    for topic in recorded:
        listener.listen(topic, STRING)
    ran = await replay(folder, "--rate", "max")
    assert ran.exit_code == 0, ran.err
    await until(lambda: listener.heard == recorded)
