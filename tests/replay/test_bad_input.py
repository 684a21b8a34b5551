"""A replay of what is damaged or foreign plays what it can, and names the rest."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from robotctl.recording.mcap_format import MAGIC
from robotctl.testing.bags import STRING, Line, text, write_bag

Until = Callable[[Callable[[], object]], Awaitable[None]]
SAMPLES = Path(__file__).parents[3] / "shared" / "samples" / "rosbag2"


def talk(count: int) -> list[Line]:
    return [Line("/alpha", STRING, n * 1.0, text(f"number {n}")) for n in range(count)]


async def test_a_damaged_chunk_costs_its_own_messages_and_is_named(
    tmp_path: Path, listener: Any, replay: Any, until: Until
) -> None:
    lines = talk(200)
    file = write_bag(tmp_path / "run.mcap", lines, chunk_bytes=1000)
    content = bytearray(file.read_bytes())
    content[len(content) // 3] ^= 0xFF
    file.write_bytes(content)
    listener.listen("/alpha", STRING)
    ran = await replay(file, "--json")
    assert ran.exit_code == 6
    assert ran.err.startswith(f"robotctl: {file} is incomplete: run.mcap: messages between bytes ")
    assert 100 < ran.summary["sent"] < 200
    recorded = [line.data for line in lines]
    await until(lambda: len(listener.heard["/alpha"]) == ran.summary["sent"])
    sent = iter(recorded)
    assert all(data in sent for data in listener.heard["/alpha"])


async def test_a_file_of_another_profile_is_played_as_far_as_its_messages_are_ours(
    tmp_path: Path, listener: Any, replay: Any, until: Until
) -> None:
    lines = [*talk(5), Line("/old", "std_msgs/String", 6.0, b"x", encoding="ros1")]
    file = write_bag(tmp_path / "run.mcap", lines)
    content = file.read_bytes()
    assert content.count(b"\4\0\0\0ros2") == 1
    file.write_bytes(content.replace(b"\4\0\0\0ros2", b"\4\0\0\0ros1"))
    listener.listen("/alpha", STRING)
    ran = await replay(file, "--json")
    assert ran.exit_code == 0, ran.err
    assert ran.summary["skipped"] == {"/old": "is encoded as ros1, not as cdr"}
    await until(lambda: listener.heard["/alpha"] == [line.data for line in lines[:5]])


async def test_nothing_but_a_beginning_is_one_sentence(tmp_path: Path, replay: Any) -> None:
    file = tmp_path / "run.mcap"
    file.write_bytes(MAGIC)
    ran = await replay(file)
    assert (ran.exit_code, ran.out) == (6, "")
    assert ran.err.count("\n") == 1


@pytest.mark.skipif(not SAMPLES.is_dir(), reason="the sample recordings are not here")
@pytest.mark.parametrize(
    ("bag", "sent", "unserved", "skipped"),
    [
        ("cdr_test", 7, 0, {}),
        (
            "bag_with_topics_and_service_events",
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
    bag: str, sent: int, unserved: int, skipped: dict[str, str], replay: Any
) -> None:
    ran = await replay(SAMPLES / bag, "--publish-service-requests", "--json")
    assert ran.exit_code == 0
    assert (ran.summary["sent"], ran.summary["failed"]) == (sent, unserved)
    assert ran.summary["skipped"] == skipped
