"""The replay process obeys lines on stdin, and ends with stdin.

Other nodes receive the recorded messages, byte for byte and in order.
A replay is never mistaken for a robot, and no robot obeys it.
"""

from __future__ import annotations

import os
import resource
from collections.abc import Awaitable, Callable, Iterator
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import Any

import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from robotctl.base.processes import program, start
from robotctl.cli.commands.recordings.replay_play import PLAYER
from robotctl.replay.job import Job
from robotctl.replay.playback_control import RATES, Command
from tests.support.bags import (
    LATCHED,
    OTHER_HASH,
    SENSOR,
    STRING,
    TWIST,
    Line,
    data,
    in_order,
    padded,
    talk,
    text,
    twist,
    write_bag,
)
from tests.support.waiting import DEADLINE_S

Until = Callable[[Callable[[], object]], Awaitable[None]]


class Playing:
    """The replay process, controlled as the command line does."""

    def __init__(self, job: Job) -> None:
        self._child = start(program(PLAYER), with_stdin=True)
        self.write(f"{job.to_json()}\n".encode())

    def urgent_threads(self) -> int:
        """Return how many of its threads run under SCHED_FIFO."""
        found = 0
        for thread in Path(f"/proc/{self._child.pid}/task").iterdir():
            with suppress(ProcessLookupError):
                policy = os.sched_getscheduler(int(thread.name))
                found += policy & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO
        return found

    def tell(self, *commands: Command) -> None:
        self.write(b"".join(command.line() for command in commands))

    def end(self) -> tuple[int, dict[str, Any]]:
        """Close its stdin; return exit code and summary."""
        self._child.close_stdin()
        summary: dict[str, Any] = {}
        with suppress(EOFError):
            while True:
                for said in self._child.receive(DEADLINE_S):
                    summary = said.get("summary", summary)
        return self._child.wait(DEADLINE_S) or 0, summary

    def close(self) -> None:
        self._child.close(DEADLINE_S)

    def write(self, data: bytes) -> None:
        self._child.send(data)


@pytest.fixture
def child(domain_id: int, own_sockets: None) -> Iterator[Callable[[Job], Playing]]:
    with ExitStack() as started:

        def begin(job: Job) -> Playing:
            return started.enter_context(closing(Playing(job)))

        yield begin


@pytest.fixture
def play(
    tmp_path: Path, listener: Any, child: Callable[[Job], Playing], domain_id: int
) -> Callable[..., Playing]:
    """A function that plays numbered messages to the listener."""

    def begin(count: int, period_ms: float = 10.0, **options: Any) -> Playing:
        lines = [Line("/alpha", STRING, n * period_ms, text(f"{n}")) for n in range(count)]
        listener.listen("/alpha", STRING)
        file = write_bag(tmp_path / "run.mcap", lines)
        return child(Job(file, domain_id, **options))

    return begin


async def test_steps_and_rates_reach_the_player_also_those_that_were_asked_for_early(
    listener: Any, play: Any, until: Until
) -> None:
    playing = play(4, period_ms=3_600_000.0)
    heard = listener.heard["/alpha"]
    playing.tell(Command.PAUSE, Command.NEXT, Command.NEXT)
    await until(lambda: len(heard) == 2)
    playing.tell(Command.FASTER, Command.NEXT)
    await until(lambda: len(heard) == 3)
    exit_code, summary = playing.end()
    assert (exit_code, summary["sent"], summary["interrupted"]) == (0, 3, True)
    assert heard == [text(f"{n}") for n in range(3)]


async def test_what_is_no_command_stops_nothing(listener: Any, play: Any, until: Until) -> None:
    playing = play(5, paused=True)
    playing.write(b'nonsense\n\xff\n{}\n\n[]\n{"do": "explode"}\n{"do": {}}\n')
    playing.tell(Command.RESUME)
    await until(lambda: len(listener.heard["/alpha"]) == 5)


async def test_what_is_stopped_before_everybody_is_known_opens_nothing(
    tmp_path: Path, listener: Any, child: Any, domain_id: int
) -> None:
    # Before it opens a topic of commands, it waits until nothing changes for a while.
    file = write_bag(tmp_path / "run.mcap", [Line("/cmd_vel", TWIST, 0.0, twist(1.0))])
    exit_code, summary = child(Job(file, domain_id, topics=("/cmd_vel",))).end()
    assert (exit_code, summary["topics"], summary["interrupted"]) == (0, [], True)


def may_be_urgent() -> bool:
    """Return whether SCHED_FIFO is permitted here."""
    soft_limit, _ = resource.getrlimit(resource.RLIMIT_RTPRIO)
    return os.geteuid() == 0 or soft_limit != 0


@pytest.mark.skipif(not may_be_urgent(), reason="SCHED_FIFO is not permitted here")
async def test_the_thread_that_keeps_time_is_urgent_until_it_stays_behind(
    play: Any, until: Until
) -> None:
    playing = play(1000, loop=True)
    await until(lambda: playing.urgent_threads() == 1)
    playing.tell(*[Command.FASTER] * len(RATES))
    await until(lambda: playing.urgent_threads() == 0)
    exit_code, summary = playing.end()
    assert (exit_code, summary["interrupted"]) == (0, True)


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
    assert ran.summary["played_s"] == pytest.approx(0.3)
    assert 0 <= ran.summary["timing_error_us"]["p50"] <= ran.summary["timing_error_us"]["max"]


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


async def test_without_a_domain_of_ones_own_the_replay_goes_where_the_robots_daemon_is(
    tmp_path: Path, replay: Any, daemon: Any, domain_id: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = write_bag(tmp_path / "run.mcap", talk("/alpha", 3))
    monkeypatch.delenv("ROS_DOMAIN_ID")
    async with daemon("r2"):
        ran = await replay(file, "--robot", "r2", "--json")
    assert (ran.summary["domain_id"], ran.summary["prefix"]) == (domain_id, "/replay")


async def test_the_cure_for_changed_types_moves_no_idle_robot(
    tmp_path: Path, listener: Any, replay: Any, daemon: Any, until: Until
) -> None:
    commands = [Line("/cmd_vel", TWIST, n, twist(1.0)) for n in range(10)]
    changed = talk("/alpha", 10, type_hash=OTHER_HASH)
    file = write_bag(tmp_path / "run.mcap", in_order(commands, changed))
    for topic, type_name in (("/cmd_vel", TWIST), ("/replay/cmd_vel", TWIST)):
        listener.listen(topic, type_name)
    async with daemon():
        ran = await replay(file, "--force-types")
    assert ran.exit_code == 0, ran.err
    await until(lambda: listener.heard["/replay/cmd_vel"] == data(commands))
    assert listener.heard["/cmd_vel"] == []


async def test_original_names_take_commands_along_if_named_and_are_refused_beside_a_moving_robot(
    tmp_path: Path, listener: Any, replay: Any, daemon: Any, until: Until
) -> None:
    commands = [Line("/cmd_vel", TWIST, n, twist(1.0)) for n in range(10)]
    file = write_bag(tmp_path / "run.mcap", in_order(commands, talk("/alpha", 10)))
    listener.listen("/cmd_vel", TWIST)
    listener.listen("/alpha", STRING)
    async with daemon("r2") as running, daemon("r1"):
        ran = await replay(file, "--original-names", "--json")
        assert ran.summary["withheld"] == {"/cmd_vel": 10}
        await until(lambda: len(listener.heard["/alpha"]) == 10)
        assert listener.heard["/cmd_vel"] == []
        named = ("--topics", "/cmd_vel", "--regex", ".")
        ran = await replay(file, "--original-names", *named, "--json")
        assert ran.exit_code == 0, ran.err
        assert (ran.summary["prefix"], ran.summary["withheld"]) == ("", {})
        await until(lambda: listener.heard["/cmd_vel"] == data(commands))
        await until(lambda: len(listener.heard["/alpha"]) == 20)
        running.mode = "MOVING"
        ran = await replay(file, "--original-names")
    assert (ran.exit_code, ran.out) == (4, "")
    assert ran.err.startswith("robotctl: --original-names is refused while robot 'r2' is MOVING")
    assert len(listener.heard["/alpha"]) == 20


async def test_original_names_end_when_the_robot_begins_to_move(
    tmp_path: Path, listener: Any, start: Any, daemon: Any, until: Until
) -> None:
    file = write_bag(tmp_path / "run.mcap", talk("/alpha", 1000, 100.0))
    listener.listen("/alpha", STRING)
    async with daemon() as running:
        replaying = start(file, "--original-names")
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
    assert "has joined ROS domain" in ran.err
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
    ran = await replay(file, "--original-names")
    assert ran.exit_code == 4
    assert "in an unknown mode" in ran.err


@pytest.mark.parametrize("topic", ["/cmd_vel", pytest.param("/base/speed", marks=pytest.mark.slow)])
async def test_commands_are_withheld_unless_named(
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


async def test_commands_are_not_even_announced_to_a_robot_that_comes_later(
    tmp_path: Path, listener: Any, start: Any, until: Until
) -> None:
    commands = [Line("/cmd_vel", TWIST, n * 10.0, twist(1.0)) for n in range(10_000)]
    file = write_bag(tmp_path / "run.mcap", in_order(commands, talk("/alpha", 1000, 100.0)))
    listener.listen("/alpha", STRING)
    replaying = start(file, "--json")
    await until(lambda: listener.heard["/alpha"])
    listener.listen("/cmd_vel", TWIST)
    heard = len(listener.heard["/alpha"])
    await until(lambda: len(listener.heard["/alpha"]) > heard + 10)
    assert listener.node.count_publishers("/cmd_vel") == 0
    assert listener.heard["/cmd_vel"] == []
    replaying.interrupt()
    ran = await replaying.end()
    assert ran.summary["withheld"] == {"/cmd_vel": 10_000}
