"""`robotctl verify`: what it prints, and its exit code."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import Writer

from robotctl.recording import Recorder
from robotctl.testing.drives import TWIST
from tests.support.recordings import write_numbered

Cli = Callable[..., Any]


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    recorder = Recorder(tmp_path / "run", metadata=lambda: {"robot": "r"}, on_failure=print)
    write_numbered(recorder, recorder.add_topic(TWIST), range(100))
    recorder.close()
    return tmp_path / "run"


def test_a_whole_recording_without_a_seal_exits_with_4(recording: Path, cli: Cli) -> None:
    ran = cli("verify", str(recording))
    assert ran.exit_code == 4
    assert ran.out.splitlines()[0].split() == ["whole", str(recording)]
    assert "100 messages, finished" in ran.out
    assert "not sealed" in ran.err


def test_a_file_of_the_mcap_library_is_whole_though_it_names_groups_without_records(
    tmp_path: Path, cli: Cli
) -> None:
    file = tmp_path / "library.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        channel = writer.register_channel("/a", "cdr", schema)
        writer.add_message(channel, 1, b"\0\1\0\0\2\0\0\0a\0", 1)
        writer.finish()
    ran = cli("verify", str(file))
    assert ran.out.splitlines()[0].split() == ["whole", str(file)]
    assert ran.exit_code == 4


def test_a_flipped_bit_exits_with_7_and_its_byte_is_named(recording: Path, cli: Cli) -> None:
    (file,) = recording.glob("*.mcap")
    data = bytearray(file.read_bytes())
    data[30] ^= 2
    file.write_bytes(data)
    ran = cli("verify", str(recording), "--json")
    assert ran.exit_code == 7
    (report,) = json.loads(ran.out)["recordings"]
    assert report["verdict"] == "broken"
    assert any(flaw["start"] <= 30 < flaw["end"] for flaw in report["files"][0]["flaws"])


def test_what_is_no_recording_exits_with_6(tmp_path: Path, cli: Cli) -> None:
    (tmp_path / "x.mcap").write_bytes(b"nothing")
    ran = cli("verify", str(tmp_path / "x.mcap"))
    assert ran.exit_code == 6
    assert "not an MCAP file" in ran.out


def test_the_gravest_recording_determines_the_exit_code(
    recording: Path, tmp_path: Path, cli: Cli
) -> None:
    (tmp_path / "x.mcap").write_bytes(b"nothing")
    assert cli("verify", str(recording), str(tmp_path / "x.mcap")).exit_code == 6
