"""The replay process obeys lines on stdin, and ends with stdin.

Other nodes receive the recorded messages, byte for byte and in order.
A replay is never mistaken for a robot, and no robot obeys it.
"""

from __future__ import annotations

import os
import resource
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import Any

import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from robotctl.base.processes import program, start
from robotctl.cli.commands.recordings.replay_play import PLAYER
from robotctl.replay.job import Job
from robotctl.replay.playback_control import RATES, Command
from tests.replay.conftest import Stage
from tests.support.bags import (
    LATCHED,
    OTHER_HASH,
    SAMPLES,
    SENSOR,
    STRING,
    TWIST,
    Line,
    data,
    in_order,
    needs_samples,
    padded,
    talk,
    text,
    twist,
)
from tests.support.waiting import DEADLINE_S
from tests.support.waiting import loop_until as until


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
def play(stage: Stage) -> Iterator[Callable[..., Playing]]:
    """A function that plays numbered messages to the listener."""
    with ExitStack() as started:

        def begin(count: int, period_ms: float = 10.0, **options: Any) -> Playing:
            lines = [Line("/alpha", STRING, n * period_ms, text(f"{n}")) for n in range(count)]
            job = Job(stage.bag(lines, heard=True), stage.domain_id, **options)
            return started.enter_context(closing(Playing(job)))

        yield begin


async def test_steps_and_rates_reach_the_player_also_those_that_were_asked_for_early(
    play: Any, stage: Stage
) -> None:
    playing = play(4, period_ms=3_600_000.0)
    heard = stage.heard["/alpha"]
    playing.tell(Command.PAUSE, Command.NEXT, Command.NEXT)
    await until(lambda: len(heard) == 2)
    playing.tell(Command.FASTER, Command.NEXT)
    await until(lambda: len(heard) == 3)
    exit_code, summary = playing.end()
    assert (exit_code, summary["sent"], summary["interrupted"]) == (0, 3, True)
    assert heard == [text(f"{n}") for n in range(3)]


async def test_what_is_no_command_stops_nothing(play: Any, stage: Stage) -> None:
    playing = play(5, paused=True)
    playing.write(b'nonsense\n\xff\n{}\n\n[]\n{"do": "explode"}\n{"do": {}}\n')
    playing.tell(Command.RESUME)
    await until(lambda: len(stage.heard["/alpha"]) == 5)


async def test_what_is_stopped_before_everybody_is_known_opens_nothing(
    stage: Stage,
) -> None:
    # Before it opens a topic of commands, it waits until nothing changes for a while.
    file = stage.bag([Line("/cmd_vel", TWIST, 0.0, twist(1.0))])
    with closing(Playing(Job(file, stage.domain_id, topics=("/cmd_vel",)))) as playing:
        exit_code, summary = playing.end()
    assert (exit_code, summary["topics"], summary["interrupted"]) == (0, [], True)


def may_be_urgent() -> bool:
    """Return whether SCHED_FIFO is permitted here."""
    soft_limit, _ = resource.getrlimit(resource.RLIMIT_RTPRIO)
    return os.geteuid() == 0 or soft_limit != 0


@pytest.mark.skipif(not may_be_urgent(), reason="SCHED_FIFO is not permitted here")
async def test_the_thread_that_keeps_time_is_urgent_until_it_stays_behind(
    play: Any,
) -> None:
    playing = play(1000, loop=True)
    await until(lambda: playing.urgent_threads() == 1)
    playing.tell(*[Command.FASTER] * len(RATES))
    await until(lambda: playing.urgent_threads() == 0)
    exit_code, summary = playing.end()
    assert (exit_code, summary["interrupted"]) == (0, True)


COMMANDS = [Line("/cmd_vel", TWIST, n, twist(1.0)) for n in range(10)]
LATCHED_QOS = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
SENSOR_QOS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)


@pytest.mark.parametrize("rate", ["1", pytest.param("max", marks=pytest.mark.slow)])
async def test_every_message_is_published_again_with_its_bytes_in_its_order(
    rate: str, stage: Stage
) -> None:
    alpha, beta = talk("/alpha", 200), talk("beta", 150, 7.0)
    sensor = talk("/sensor", 100, 10.0, qos=SENSOR)
    commands = [Line("/cmd_vel", TWIST, n * 10.0, twist(n / 100)) for n in range(100)]
    file = stage.bag(in_order(alpha, beta, sensor, commands))
    stage.listen("/alpha", "/beta")
    stage.listen("/sensor", qos=SENSOR_QOS)
    ran = await stage.replay(file, "--rate", rate, "--json")
    assert ran.exit_code == 0, ran.err
    await until(lambda: len(stage.heard["/sensor"]) == 100)
    assert stage.heard == {
        "/alpha": data(alpha),
        "/beta": data(beta),
        "/sensor": data(sensor),
    }
    assert ran.summary["sent"] == 450
    assert ran.summary["withheld"] == {"/cmd_vel": 100}
    assert (ran.summary["failed"], ran.summary["skipped"]) == (0, {})
    assert (ran.summary["timing_error_us"] is None) == (rate == "max")


@pytest.mark.slow
async def test_a_subscriber_that_reads_slowly_gets_everything_at_full_speed(stage: Stage) -> None:
    lines = talk("/flood", 12_000, 0.01)
    file = stage.bag(lines)
    stage.listen("/flood", qos=20)
    ran = await stage.replay(file, "--rate", "max", "--json")
    assert ran.summary["sent"] == 12_000
    assert ran.summary["failed"] == 0


async def test_topics_exclude_offset_and_duration_choose_what_is_played(stage: Stage) -> None:
    alpha, beta, gamma = (talk(f"/{name}", 100, 10.0) for name in ("alpha", "beta", "gamma"))
    file = stage.bag(in_order(alpha, beta, gamma), heard=True)
    ran = await stage.replay(
        file, "--topics", "alpha,/beta", "--exclude", "/beta", "--start-offset", "0.2",
        "--duration", "0.3", "--rate", "5", "--json",
    )  # fmt: skip
    assert ran.exit_code == 0, ran.err
    await until(lambda: len(stage.heard["/alpha"]) == ran.summary["sent"])
    assert stage.heard == {"/alpha": data(alpha[20:51]), "/beta": [], "/gamma": []}
    assert ran.summary["played_s"] == pytest.approx(0.3)
    assert 0 <= ran.summary["timing_error_us"]["p50"] <= ran.summary["timing_error_us"]["max"]


async def test_a_loop_begins_again_until_ctrl_c_which_takes_the_publishers_away(
    stage: Stage,
) -> None:
    lines = talk("/alpha", 4, 10.0)
    file = stage.bag(lines, heard=True)
    running = stage.start(file, "--loop", "--json")
    heard = stage.heard["/alpha"]
    await until(lambda: len(heard) > 9)
    assert heard[:8] == data(lines) * 2
    running.interrupt()
    ran = await running.end()
    assert ran.exit_code == 130
    assert ran.err == ""
    assert ran.summary["interrupted"]
    await until(lambda: stage.node.count_publishers("/alpha") == 0)


async def test_a_replay_does_not_outlive_the_command(stage: Stage) -> None:
    file = stage.bag(talk("/alpha", 4, 10.0), heard=True)
    running = stage.start(file, "--loop")
    await until(lambda: stage.heard["/alpha"])
    running.kill()
    await until(lambda: stage.node.count_publishers("/alpha") == 0)


async def test_what_was_latched_before_the_offset_is_latched_again(stage: Stage) -> None:
    latched = talk("/map", 3, 10.0, qos=LATCHED)
    file = stage.bag(in_order(latched, talk("/alpha", 100, 100.0)))
    stage.listen("/alpha")
    stage.start(file, "--start-offset", "1")
    await until(lambda: stage.heard["/alpha"])
    stage.listen("/map", qos=LATCHED_QOS)  # late
    await until(lambda: stage.heard["/map"])
    assert stage.heard["/map"] == data(latched[-1:])


@needs_samples
@pytest.mark.parametrize("bag", [pytest.param("talker", marks=pytest.mark.slow), "split_bag"])
async def test_a_folder_of_rosbag2_is_played_in_order(bag: str, stage: Stage) -> None:
    from robotctl.recording import read_messages

    recorded: dict[str, list[bytes]] = {}
    for message in read_messages(SAMPLES / bag):
        if message.type_name == STRING:
            recorded.setdefault(f"/{message.topic.lstrip('/')}", []).append(padded(message.data))
    stage.listen(*recorded)
    ran = await stage.replay(SAMPLES / bag, "--rate", "max")
    assert ran.exit_code == 0, ran.err
    await until(lambda: stage.heard == recorded)


async def test_with_a_daemon_in_the_domain_everything_goes_below_replay(stage: Stage) -> None:
    file = stage.bag(in_order(COMMANDS, talk("/odd/alpha", 10)))
    stage.listen("/cmd_vel", "/replay/cmd_vel", type_name=TWIST)
    stage.listen("/odd/alpha", "/replay/odd/alpha")
    async with stage.daemon("r2", mode="MOVING"):
        ran = await stage.replay(file)
    assert ran.exit_code == 0, ran.err
    assert ran.out.count("\n") == 3
    assert ran.out.startswith("a daemon ('r2') runs in ROS domain ")
    assert "below /replay" in ran.out.splitlines()[0]
    await until(lambda: len(stage.heard["/replay/odd/alpha"]) == 10)
    assert stage.heard["/replay/cmd_vel"] == data(COMMANDS)
    assert stage.heard["/cmd_vel"] == stage.heard["/odd/alpha"] == []


async def test_without_a_domain_of_ones_own_the_replay_goes_where_the_robots_daemon_is(
    monkeypatch: pytest.MonkeyPatch, stage: Stage
) -> None:
    file = stage.bag(talk("/alpha", 3))
    monkeypatch.delenv("ROS_DOMAIN_ID")
    async with stage.daemon("r2"):
        ran = await stage.replay(file, "--robot", "r2", "--json")
    assert (ran.summary["domain_id"], ran.summary["prefix"]) == (stage.domain_id, "/replay")


async def test_the_cure_for_changed_types_moves_no_idle_robot(stage: Stage) -> None:
    changed = talk("/alpha", 10, type_hash=OTHER_HASH)
    file = stage.bag(in_order(COMMANDS, changed))
    stage.listen("/cmd_vel", "/replay/cmd_vel", type_name=TWIST)
    async with stage.daemon():
        ran = await stage.replay(file, "--force-types")
    assert ran.exit_code == 0, ran.err
    await until(lambda: stage.heard["/replay/cmd_vel"] == data(COMMANDS))
    assert stage.heard["/cmd_vel"] == []


async def test_original_names_take_commands_along_if_named_and_are_refused_beside_a_moving_robot(
    stage: Stage,
) -> None:
    file = stage.bag(in_order(COMMANDS, talk("/alpha", 10)), heard=True)
    async with stage.daemon("r2") as running, stage.daemon("r1"):
        ran = await stage.replay(file, "--original-names", "--json")
        assert ran.summary["withheld"] == {"/cmd_vel": 10}
        await until(lambda: len(stage.heard["/alpha"]) == 10)
        assert stage.heard["/cmd_vel"] == []
        named = ("--topics", "/cmd_vel", "--regex", ".")
        ran = await stage.replay(file, "--original-names", *named, "--json")
        assert ran.exit_code == 0, ran.err
        assert (ran.summary["prefix"], ran.summary["withheld"]) == ("", {})
        await until(lambda: stage.heard["/cmd_vel"] == data(COMMANDS))
        await until(lambda: len(stage.heard["/alpha"]) == 20)
        running.mode = "MOVING"
        ran = await stage.replay(file, "--original-names")
    assert (ran.exit_code, ran.out) == (4, "")
    assert ran.err.startswith("robotctl: --original-names is refused while robot 'r2' is MOVING")
    assert len(stage.heard["/alpha"]) == 20


async def test_original_names_end_when_the_robot_begins_to_move(stage: Stage) -> None:
    file = stage.bag(talk("/alpha", 1000, 100.0), heard=True)
    async with stage.daemon() as running:
        replaying = stage.start(file, "--original-names")
        await until(lambda: stage.heard["/alpha"])
        running.mode = "MOVING"
        ran = await replaying.end()
    assert ran.exit_code == 4
    assert "is MOVING" in ran.err


async def test_a_daemon_that_comes_during_a_replay_ends_it(stage: Stage) -> None:
    file = stage.bag(talk("/alpha", 1000, 100.0), heard=True)
    replaying = stage.start(file)
    await until(lambda: stage.heard["/alpha"])
    async with stage.daemon():
        ran = await replaying.end()
    assert ran.exit_code == 4
    assert "has joined ROS domain" in ran.err
    await until(lambda: stage.node.count_publishers("/alpha") == 0)


@pytest.mark.slow
async def test_a_daemon_of_somebody_else_is_seen_on_the_ros_graph(stage: Stage) -> None:
    from robot_controller.msg import JournalEntry

    file = stage.bag(talk("/alpha", 10))
    stage.node.create_publisher(JournalEntry, "/r3/robotctl/journal", 10)
    ran = await stage.replay(file, "--json")
    assert ran.summary["prefix"] == "/replay"
    ran = await stage.replay(file, "--original-names")
    assert ran.exit_code == 4
    assert "in an unknown mode" in ran.err


@pytest.mark.parametrize("topic", ["/cmd_vel", pytest.param("/base/speed", marks=pytest.mark.slow)])
async def test_commands_are_withheld_unless_named(topic: str, stage: Stage) -> None:
    commands = [Line(topic, TWIST, n, twist(1.0)) for n in range(10)]
    file = stage.bag(in_order(commands, talk("/alpha", 10)), heard=True)
    ran = await stage.replay(file, "--json")
    assert ran.summary["withheld"] == {topic: 10}
    assert f"--topics {topic}" in ran.summary["notes"][0]
    await until(lambda: len(stage.heard["/alpha"]) == 10)
    assert stage.heard[topic] == []
    ran = await stage.replay(file, "--topics", topic)
    assert ran.exit_code == 0
    await until(lambda: stage.heard[topic] == data(commands))


async def test_commands_are_not_even_announced_to_a_robot_that_comes_later(stage: Stage) -> None:
    commands = [Line("/cmd_vel", TWIST, n * 10.0, twist(1.0)) for n in range(10_000)]
    file = stage.bag(in_order(commands, talk("/alpha", 1000, 100.0)))
    stage.listen("/alpha")
    replaying = stage.start(file, "--json")
    await until(lambda: stage.heard["/alpha"])
    stage.listen("/cmd_vel", type_name=TWIST)
    heard = len(stage.heard["/alpha"])
    await until(lambda: len(stage.heard["/alpha"]) > heard + 10)
    assert stage.node.count_publishers("/cmd_vel") == 0
    assert stage.heard["/cmd_vel"] == []
    replaying.interrupt()
    ran = await replaying.end()
    assert ran.summary["withheld"] == {"/cmd_vel": 10_000}
