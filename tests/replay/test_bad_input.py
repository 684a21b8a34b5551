"""A replay of a damaged or foreign recording plays what it can, and reports the rest."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from zstandard import ZstdCompressor

from robotctl.cli import app
from tests.replay.conftest import Stage
from tests.support.bags import (
    SAMPLES,
    STRING,
    TWIST,
    Line,
    data,
    in_order,
    needs_samples,
    talk,
    text,
    twist,
    write_bag,
)
from tests.support.recordings import flip
from tests.support.waiting import loop_until as until


async def test_a_damaged_chunk_costs_its_own_messages_and_is_named(stage: Stage) -> None:
    lines = talk("/alpha", 200, 1.0)
    file = stage.bag(lines, heard=True, chunk_bytes=1000)
    flip(file, file.stat().st_size // 3)
    ran = await stage.replay(file, "--json")
    assert ran.exit_code == 6
    assert ran.err.startswith(f"robotctl: {file} is incomplete: run.mcap: messages between bytes ")
    assert 100 < ran.summary["sent"] < 200
    await until(lambda: len(stage.heard["/alpha"]) == ran.summary["sent"])
    sent = iter(data(lines))
    assert all(message in sent for message in stage.heard["/alpha"])


async def test_messages_that_rosbag2_compressed_one_by_one_are_sent_as_they_were(
    tmp_path: Path, stage: Stage
) -> None:
    lines = talk("/alpha", 5, 1.0)
    stored = [replace(line, data=ZstdCompressor().compress(line.data)) for line in lines]
    write_bag(tmp_path / "bag_0.mcap", stored)
    (tmp_path / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n"
        "  compression_format: zstd\n"
        "  compression_mode: MESSAGE\n"
        "  relative_file_paths:\n    - bag_0.mcap\n"
    )
    stage.listen("/alpha")
    ran = await stage.replay(tmp_path, "--json")
    assert ran.exit_code == 0, ran.err
    await until(lambda: stage.heard["/alpha"] == data(lines))


@needs_samples
@pytest.mark.parametrize(
    ("bag", "services", "sent", "unserved", "skipped"),
    [
        ("cdr_test", (), 7, 0, {}),
        (
            "bag_with_topics_and_service_events",
            ("--topics", "/test_service1", "--topics", "/test_service2", "--regex", "."),
            2,
            4,
            {
                "/events/write_split": "has type rosbag2_interfaces/msg/WriteSplitEvent, "
                "which is not installed"
            },
        ),
    ],
)
async def test_of_a_bag_from_elsewhere_what_is_installed_is_played_and_the_rest_is_named(
    bag: str,
    services: tuple[str, ...],
    sent: int,
    unserved: int,
    skipped: dict[str, str],
    stage: Stage,
) -> None:
    ran = await stage.replay(SAMPLES / bag, "--publish-service-requests", *services, "--json")
    assert ran.exit_code == 0
    assert (ran.summary["sent"], ran.summary["failed"]) == (sent, unserved)
    assert ran.summary["skipped"] == skipped


async def test_what_cannot_be_published_is_named_and_skipped(stage: Stage) -> None:
    alpha = talk("/alpha", 10)
    zeros = [Line("/late", TWIST, 0.1, twist(0.0))]
    strings = [Line("/late", STRING, 0.2, text(each)) for each in "ab"]
    others = [
        Line("/unknown", "no_msgs/msg/Nothing", 1.0, b"\0\1\0\0"),
        Line("/old", "std_msgs/String", 1.0, text("ros 1"), encoding="ros1"),
        Line("/json", STRING, 1.0, b"{}", encoding="json"),
        Line("/two", STRING, 1.0, text("a")),
        Line("/two", TWIST, 1.0, twist(0.0)),
        Line("/a b", STRING, 1.0, text("a")),
        Line("/import", "antigravity/msg/Flight", 1.0, text("a")),
        Line("/relative", "../msg/Flight", 1.0, text("a")),
    ]
    file = stage.bag(in_order(alpha, zeros, strings, others))
    stage.listen("/alpha", "/late")
    ran = await stage.replay(file, "--json")
    assert ran.exit_code == 0, ran.err
    skipped = ran.summary["skipped"]
    assert set(skipped) == {line.topic for line in others}
    assert skipped["/unknown"] == "has type no_msgs/msg/Nothing, which is not installed"
    assert skipped["/relative"] == "has type ../msg/Flight, which is not the name of a ROS type"
    assert "antigravity" not in sys.modules
    assert skipped["/two"] == "is recorded with several types"
    assert (
        f"1 messages of /late are left out: they are {TWIST}, and most are {STRING}"
        in ran.summary["notes"]
    )
    assert len(ran.summary["notes"]) == len(skipped) + 1
    await until(lambda: stage.heard["/late"] == data(strings))
    await until(lambda: stage.heard["/alpha"] == data(alpha))


async def test_of_a_truncated_file_what_can_be_read_is_played_and_the_rest_is_told(
    stage: Stage,
) -> None:
    lines = talk("/alpha", 200, 1.0)
    file = stage.bag(lines, heard=True, chunk_bytes=1000)
    os.truncate(file, file.stat().st_size // 2)
    ran = await stage.replay(file, "--json")
    assert ran.exit_code == 6
    assert ran.err.startswith(f"robotctl: {file} is incomplete: ")
    assert ran.err.count("\n") == 1
    sent = ran.summary["sent"]
    assert 0 < sent < 200
    await until(lambda: stage.heard["/alpha"] == data(lines[:sent]))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--rate", "0"], "--rate 0: use a number"),
        (["--rate", "nan"], "--rate nan: use a number"),
        (["--rate", "-1"], "--rate -1: use a number"),
        (["--remap", "/alpha:=/1b"], "--remap /alpha:=/1b: use OLD:=NEW"),
        (["--remap", "/nope:=/b"], "--remap /nope: not in the recording, which has /alpha"),
        (["--regex", "("], "--regex (: "),
        (["--clock", "0"], "--clock 0: use 0.1 to 1000 Hz"),
        (["--delay", "-1"], "--delay -1: give seconds"),
        (["--wait-for", "-1"], "'--wait-for': -1 is not in the range"),
        (["--read-ahead", "0"], "'--read-ahead': 0 is not in the range"),
        (["--draw"], "nothing to draw"),
        (["--draw-only", "--rate", "max"], "--draw-only"),
        (["--start-offset", "100"], "the recording ends after"),
        (["--start-offset", "nan"], "--start-offset nan: give seconds"),
        (["--duration", "0"], "--duration 0: give seconds"),
        (["--topics", "/nope"], "--topics /nope: not in the recording, which has /alpha"),
        (["--domain-id", "233"], "--domain-id is '233': use 0 to 232"),
        (["--draw-only", "--domain-id", "233"], "--domain-id is '233': use 0 to 232"),
        (["--robot", "a b"], "robot name 'a b'"),
        (["run.mcap"], "give their folder"),
    ],
)
def test_an_option_that_makes_no_sense_is_one_sentence(
    arguments: list[str],
    said: str,
    tmp_path: Path,
    own_sockets: None,
    capsys: pytest.CaptureFixture[str],
) -> None:
    file = write_bag(tmp_path / "run.mcap", talk("/alpha", 3))
    exit_code = app.run(["replay", str(file), *arguments])
    out, err = capsys.readouterr()
    assert (exit_code, out) == (2, "")
    assert said in err
    assert err.count("\n") == 1


async def test_a_reader_that_has_left_is_no_failure(stage: Stage) -> None:
    lines = [Line(f"/unknown_{n}", "no_msgs/msg/Nothing", 1.0, b"\0\1\0\0") for n in range(9)]
    running = stage.start(stage.bag([*lines, *talk("/alpha", 3)]))
    running.stop_reading()
    ran = await running.end()
    assert (ran.exit_code, ran.err) == (0, "")


async def test_a_loop_over_nothing_that_can_be_played_ends(stage: Stage) -> None:
    lines = [Line("/unknown", "no_msgs/msg/Nothing", 1.0, b"\0\1\0\0")]
    ran = await stage.replay(stage.bag(lines), "--loop", "--json")
    assert (ran.exit_code, ran.summary["sent"]) == (0, 0)
