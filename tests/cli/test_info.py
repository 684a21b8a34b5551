"""info shows any MCAP, and says what is missing."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from mcap.writer import Writer

from robotctl.cli.commands.recordings.info import qos_text
from tests.cli.conftest import Cli

QOS = """\
- history: keep_last
  depth: 10
  reliability: reliable
  durability: volatile
"""


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    folder = tmp_path / "run"
    folder.mkdir()
    with (folder / "run_0.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        schema = writer.register_schema("nav_msgs/msg/Odometry", "ros2msg", b"")
        odom = writer.register_channel("/odom", "cdr", schema, {"offered_qos_profiles": QOS})
        evil = writer.register_channel("/\x1b[2J", "cdr", schema)
        for index in range(101):
            at_ns = 1_767_268_800_000_000_000 + index * 10_000_000
            writer.add_message(odom, at_ns, b"\0" * 16, at_ns)
        writer.add_message(evil, at_ns, b"\0" * 16, at_ns)
        writer.finish()
    return folder


def test_info_shows_topics_types_counts_rates_duration_and_qos(recording: Path, cli: Cli) -> None:
    for path in (recording, recording / "run_0.mcap"):
        ran = cli("info", str(path))
        assert ran.exit_code == 0
        out = ran.out
        assert "  duration   1.0 s\n" in out
        assert "  messages   102\n" in out
        odom = next(line for line in out.splitlines() if "/odom" in line)
        assert odom.split() == ["/odom", "nav_msgs/Odometry", "101", "101.0"]
        assert "    reliable, volatile, keep_last 10\n" in out
        assert "/\\x1b[2J" in out
        assert "\x1b" not in out


def test_a_truncated_file_shows_what_can_be_read_and_says_what_is_missing(
    recording: Path, cli: Cli, tmp_path: Path
) -> None:
    data = (recording / "run_0.mcap").read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: len(data) // 2])
    ran = cli("info", str(cut))
    assert ran.exit_code == 6
    assert "cut.mcap" in ran.out
    assert ran.err.startswith(f"robotctl: {cut} is incomplete: ")
    assert ran.err.count("\n") == 1
    assert "index      missing" in ran.out
    ran = cli("info", str(cut), "--json")
    assert json.loads(ran.out)["missing"]


@pytest.mark.parametrize(
    ("offered", "text"),
    [
        ("", ""),
        (QOS, "reliable, volatile, keep_last 10"),
        (QOS + QOS, "reliable, volatile, keep_last 10"),
        (
            "- history: 3\n  depth: 0\n  reliability: 2\n  durability: 1\n" + QOS,
            "best_effort, transient_local; reliable, volatile, keep_last 10",
        ),
        ("- history: keep_all\n  reliability: reliable", "reliable, keep_all"),
        ("- history: [", ""),
        ("- 3", ""),
        ("[]", ""),
        ("[" * 100_000, ""),
    ],
)
def test_qos_is_told_in_words_as_far_as_the_file_says(offered: str, text: str) -> None:
    assert qos_text(offered) == text
