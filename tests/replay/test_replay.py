"""What others see of a replay: the recorded messages, under names that are safe."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from robotctl.testing.bags import (
    LATCHED,
    SENSOR,
    STRING,
    TWIST,
    Line,
    padded,
    text,
    twist,
    write_bag,
)

Until = Callable[[Callable[[], object]], Awaitable[None]]
LATCHED_QOS = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
SENSOR_QOS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)


def talk(topic: str, count: int, period_ms: float = 5.0, qos: str = "") -> list[Line]:
    return [
        Line(topic, STRING, number * period_ms, text(f"{topic} {number}"), *([qos] * bool(qos)))
        for number in range(count)
    ]


def in_order(*topics: list[Line]) -> list[Line]:
    return sorted((line for topic in topics for line in topic), key=lambda line: line.at_ms)


def data(lines: list[Line]) -> list[bytes]:
    return [line.data for line in lines]


@pytest.mark.parametrize("rate", ["1", pytest.param("max", marks=pytest.mark.slow)])
async def test_every_message_is_published_again_with_its_bytes_in_its_order(
    rate: str, tmp_path: Path, listener: Any, replay: Any, until: Until
) -> None:
    alpha, beta = talk("/alpha", 200), talk("beta", 150, 7.0)
    sensor = talk("/sensor", 100, 10.0, SENSOR)
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
    assert ran.summary["sent"] == 550
    assert (ran.summary["failed"], ran.summary["withheld"], ran.summary["skipped"]) == (0, {}, {})
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
    latched = talk("/map", 3, 10.0, LATCHED)
    file = write_bag(tmp_path / "run.mcap", in_order(latched, talk("/alpha", 100, 100.0)))
    listener.listen("/alpha", STRING)
    start(file, "--start-offset", "1")
    await until(lambda: listener.heard["/alpha"])
    listener.listen("/map", STRING, LATCHED_QOS)  # late
    await until(lambda: listener.heard["/map"])
    assert listener.heard["/map"] == data(latched[-1:])


async def test_with_a_daemon_in_the_domain_everything_goes_below_replay(
    tmp_path: Path, listener: Any, replay: Any, daemon: Any, until: Until
) -> None:
    commands = [Line("/cmd_vel", TWIST, n, twist(1.0)) for n in range(10)]
    file = write_bag(tmp_path / "run.mcap", in_order(commands, talk("/odd/alpha", 10)))
    for topic, type_name in (("/cmd_vel", TWIST), ("/odd/alpha", STRING)):
        listener.listen(topic, type_name)
        listener.listen(f"/replay{topic}", type_name)
    async with daemon("r2", mode="MOVING"):
        ran = await replay(file)
    assert ran.exit_code == 0, ran.err
    assert ran.out.count("\n") == 3
    assert ran.out.startswith("a daemon ('r2') runs in ROS domain ")
    assert "below /replay" in ran.out.splitlines()[0]
    await until(lambda: len(listener.heard["/replay/odd/alpha"]) == 10)
    assert listener.heard["/replay/cmd_vel"] == data(commands)
    assert listener.heard["/cmd_vel"] == listener.heard["/odd/alpha"] == []


async def test_a_daemon_in_another_domain_changes_no_name(
    tmp_path: Path, replay: Any, daemon: Any, domain_id: int
) -> None:
    file = write_bag(tmp_path / "run.mcap", talk("/alpha", 10))
    async with daemon(domain=domain_id + 1):
        ran = await replay(file, "--json")
    assert (ran.summary["prefix"], ran.summary["notes"]) == ("", [])


async def test_without_a_domain_of_ones_own_the_replay_goes_where_the_robots_daemon_is(
    tmp_path: Path, replay: Any, daemon: Any, domain_id: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = write_bag(tmp_path / "run.mcap", talk("/alpha", 3))
    monkeypatch.delenv("ROS_DOMAIN_ID")
    async with daemon("r2"):
        ran = await replay(file, "--robot", "r2", "--json")
    assert (ran.summary["domain_id"], ran.summary["prefix"]) == (domain_id, "/replay")


async def test_force_uses_the_original_names_beside_a_daemon_that_does_not_move(
    tmp_path: Path, listener: Any, replay: Any, daemon: Any, until: Until
) -> None:
    commands = [Line("/cmd_vel", TWIST, n, twist(1.0)) for n in range(10)]
    file = write_bag(tmp_path / "run.mcap", commands)
    listener.listen("/cmd_vel", TWIST)
    async with daemon():
        ran = await replay(file, "--force", "--json")
    assert ran.exit_code == 0, ran.err
    await until(lambda: listener.heard["/cmd_vel"] == data(commands))


async def test_force_is_refused_while_the_robot_moves(
    tmp_path: Path, listener: Any, replay: Any, daemon: Any
) -> None:
    file = write_bag(tmp_path / "run.mcap", talk("/alpha", 10))
    listener.listen("/alpha", STRING)
    async with daemon("r2", mode="MOVING"), daemon("r1"):
        ran = await replay(file, "--force")
    assert (ran.exit_code, ran.out) == (4, "")
    assert ran.err.startswith("robotctl: --force is refused while robot 'r2' is MOVING")
    assert listener.heard["/alpha"] == []


async def test_force_ends_when_the_robot_begins_to_move(
    tmp_path: Path, listener: Any, start: Any, daemon: Any, until: Until
) -> None:
    file = write_bag(tmp_path / "run.mcap", talk("/alpha", 1000, 100.0))
    listener.listen("/alpha", STRING)
    async with daemon() as running:
        replaying = start(file, "--force")
        await until(lambda: listener.heard["/alpha"])
        running.mode = "MOVING"
        ran = await replaying.end()
    assert ran.exit_code == 4
    assert "is MOVING" in ran.err


async def test_a_daemon_that_comes_during_a_replay_ends_it(
    tmp_path: Path, listener: Any, start: Any, daemon: Any, until: Until
) -> None:
    file = write_bag(tmp_path / "run.mcap", talk("/alpha", 1000, 100.0))
    listener.listen("/alpha", STRING)
    replaying = start(file)
    await until(lambda: listener.heard["/alpha"])
    async with daemon():
        ran = await replaying.end()
    assert ran.exit_code == 4
    assert "has come into ROS domain" in ran.err
    await until(lambda: listener.node.count_publishers("/alpha") == 0)


@pytest.mark.slow
async def test_a_daemon_of_somebody_else_is_seen_on_the_ros_graph(
    tmp_path: Path, listener: Any, replay: Any
) -> None:
    from robot_controller.msg import JournalEntry

    file = write_bag(tmp_path / "run.mcap", talk("/alpha", 10))
    listener.node.create_publisher(JournalEntry, "/r3/robotctl/journal", 10)
    ran = await replay(file, "--json")
    assert ran.summary["prefix"] == "/replay"
    ran = await replay(file, "--force")
    assert ran.exit_code == 4
    assert "mode that it does not tell" in ran.err


@pytest.mark.parametrize("topic", ["/cmd_vel", pytest.param("/base/speed", marks=pytest.mark.slow)])
async def test_commands_that_somebody_would_obey_are_withheld_unless_named(
    topic: str, tmp_path: Path, listener: Any, replay: Any, until: Until
) -> None:
    commands = [Line(topic, TWIST, n, twist(1.0)) for n in range(10)]
    file = write_bag(tmp_path / "run.mcap", in_order(commands, talk("/alpha", 10)))
    listener.listen(topic, TWIST)
    listener.listen("/alpha", STRING)
    ran = await replay(file, "--json")
    assert ran.summary["withheld"] == {topic: 10}
    assert f"--topics {topic}" in ran.summary["notes"][0]
    await until(lambda: len(listener.heard["/alpha"]) == 10)
    assert listener.heard[topic] == []
    ran = await replay(file, "--topics", topic)
    assert ran.exit_code == 0
    await until(lambda: listener.heard[topic] == data(commands))


async def test_commands_are_withheld_from_when_somebody_would_obey(
    tmp_path: Path, listener: Any, start: Any, until: Until
) -> None:
    commands = [Line("/cmd_vel", TWIST, n * 10.0, twist(1.0)) for n in range(10_000)]
    file = write_bag(tmp_path / "run.mcap", in_order(commands, talk("/alpha", 1000, 100.0)))
    listener.listen("/alpha", STRING)
    replaying = start(file, "--json")
    await until(lambda: listener.heard["/alpha"])
    listener.listen("/cmd_vel", TWIST)
    commands_heard, others_heard = listener.heard["/cmd_vel"], listener.heard["/alpha"]
    last = (0, 0)

    def is_silent() -> bool:
        """No command while ten others came."""
        nonlocal last
        if len(commands_heard) > last[0]:
            last = len(commands_heard), len(others_heard)
        return last[0] > 0 and len(others_heard) > last[1] + 10

    await until(is_silent)
    replaying.interrupt()
    ran = await replaying.end()
    assert 0 < ran.summary["withheld"]["/cmd_vel"] < 10_000


async def test_what_cannot_be_published_is_named_and_skipped(
    tmp_path: Path, listener: Any, replay: Any, until: Until
) -> None:
    alpha = talk("/alpha", 10)
    others = [
        Line("/unknown", "no_msgs/msg/Nothing", 1.0, b"\0\1\0\0"),
        Line("/old", "std_msgs/String", 1.0, text("ros 1")),
        Line("/json", STRING, 1.0, b"{}", encoding="json"),
        Line("/two", STRING, 1.0, text("a")),
        Line("/two", TWIST, 1.0, twist(0.0)),
        Line("/a b", STRING, 1.0, text("a")),
        Line("/import", "antigravity/msg/Flight", 1.0, text("a")),
        Line("/relative", "../msg/Flight", 1.0, text("a")),
    ]
    file = write_bag(tmp_path / "run.mcap", in_order(alpha, others))
    listener.listen("/alpha", STRING)
    ran = await replay(file, "--json")
    assert ran.exit_code == 0, ran.err
    skipped = ran.summary["skipped"]
    assert set(skipped) == {line.topic for line in others}
    assert skipped["/unknown"] == "has type no_msgs/msg/Nothing, which is not installed"
    assert skipped["/two"] == "is recorded with several types"
    assert len(ran.summary["notes"]) == len(skipped)
    await until(lambda: listener.heard["/alpha"] == data(alpha))


@pytest.mark.parametrize(
    ("content", "said"),
    [(None, "No such file"), (b"", "empty"), (b"hello" * 50, "no MCAP file")],
)
async def test_what_is_no_recording_is_one_sentence(
    content: bytes | None, said: str, tmp_path: Path, replay: Any
) -> None:
    file = tmp_path / "any.mcap"
    if content is not None:
        file.write_bytes(content)
    ran = await replay(file)
    assert (ran.exit_code, ran.out) == (6, "")
    assert ran.err.count("\n") == 1
    assert said in ran.err


async def test_of_a_truncated_file_what_can_be_read_is_played_and_the_rest_is_told(
    tmp_path: Path, listener: Any, replay: Any, until: Until
) -> None:
    lines = talk("/alpha", 200, 1.0)
    file = write_bag(tmp_path / "run.mcap", lines, chunk_bytes=1000)
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    listener.listen("/alpha", STRING)
    ran = await replay(file, "--json")
    assert ran.exit_code == 6
    assert ran.err.startswith(f"robotctl: {file} is incomplete: ")
    assert ran.err.count("\n") == 1
    sent = ran.summary["sent"]
    assert 0 < sent < 200
    await until(lambda: listener.heard["/alpha"] == data(lines[:sent]))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--rate", "0"], "--rate 0: use a number"),
        (["--rate", "nan"], "--rate nan: use a number"),
        (["--start-offset", "100"], "the recording ends after"),
        (["--start-offset", "nan"], "--start-offset nan: give seconds"),
        (["--duration", "0"], "--duration 0: give seconds"),
        (["--topics", "/nope"], "--topics /nope: not in the recording, which has /alpha"),
        (["--domain-id", "233"], "--domain-id is '233': use 0 to 232"),
        (["--robot", "a b"], "robot name 'a b'"),
    ],
)
async def test_an_option_that_makes_no_sense_is_one_sentence(
    arguments: list[str], said: str, tmp_path: Path, replay: Any
) -> None:
    file = write_bag(tmp_path / "run.mcap", talk("/alpha", 3))
    ran = await replay(file, *arguments)
    assert (ran.exit_code, ran.out) == (2, "")
    assert said in ran.err
    assert ran.err.count("\n") == 1


async def test_a_recording_without_messages_is_played_at_once(tmp_path: Path, replay: Any) -> None:
    ran = await replay(write_bag(tmp_path / "run.mcap", []))
    assert ran.exit_code == 0, ran.err
    assert "sent        0 messages" in ran.out


@pytest.mark.parametrize("bag", [pytest.param("talker", marks=pytest.mark.slow), "split_bag"])
async def test_a_folder_of_rosbag2_is_played_in_order(
    bag: str, listener: Any, replay: Any, until: Until
) -> None:
    from robotctl.recording.reader import read_messages

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
