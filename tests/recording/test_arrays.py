"""Fields of a topic as arrays with time."""

from __future__ import annotations

import shutil
from math import nan
from pathlib import Path

import numpy as np
import pytest

from robotctl.base.errors import UnreadableFile, UsageError
from robotctl.messages.definition import parse_definition
from robotctl.messages.values import encode
from robotctl.recording import Topic, read_arrays, read_messages
from robotctl.testing.drives import GID
from tests.support.recordings import Tape

GOLDEN = Path(__file__).parents[1] / "golden"
START_NS = 1_700_000_000_000_000_000

DEFINITION = """\
float32 x
int64 count
string name
float64[3] triple
uint16[] ranges
string[] names
uint8[] image
Part[2] parts
Part[] many
================================================================================
MSG: p/Part
bool y
"""


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Return a recording of three messages, one second apart."""
    recorder = Tape(tmp_path / "run")
    definition = parse_definition("p/msg/All", DEFINITION)
    channel = recorder.add_topic(Topic("/all", "p/msg/All", DEFINITION))
    for number in range(3):
        values = {
            "x": [0.1, nan, 2.0][number],
            "count": (1 << 60) + number,
            "name": f"n{number}\0",
            "triple": [number, 1.0, 2.0],
            "ranges": list(range(number)),
            "names": ["a"] * number,
            "image": bytes(number),
            "parts": [{"y": False}, {"y": True}],
            "many": [],
        }
        log_ns = START_NS + number * 10**9
        recorder.write(channel, encode(definition, values), log_ns, log_ns - 7, 1, GID)
    recorder.close()
    return tmp_path / "run"


def test_each_field_has_its_type_and_one_entry_for_each_message(run: Path) -> None:
    found = read_arrays(run, "all", "x", "count", "parts[1].y", "triple", "triple[0]")
    assert (found.topic, found.type_name, len(found)) == ("/all", "p/msg/All", 3)
    assert found.time_s.tolist() == [0.0, 1.0, 2.0]
    assert (found.log_ns - found.publish_ns).tolist() == [7, 7, 7]
    assert found["x"].dtype == np.float32
    assert np.isnan(found["x"]).tolist() == [False, True, False]
    assert found["count"].tolist() == [(1 << 60) + number for number in range(3)]
    assert found["parts[1].y"].dtype == bool
    assert found["triple"].shape == (3, 3)
    assert found["triple[0]"].tolist() == [0.0, 1.0, 2.0]
    assert set(found.fields) == {"x", "count", "parts[1].y", "triple", "triple[0]"}


@pytest.mark.parametrize(
    ("topic", "field", "sentence"),
    [
        ("/all", "y", "p/All has no field 'y': did you mean many?"),
        ("/all", "parts", "parts is no number, text or list of them: name a field below it"),
        ("/all", "ranges[0]", "ranges[0] is no number, text or list of them"),
        ("/al", "x", "no topic /al in "),
    ],
)
def test_what_is_not_there_is_named(run: Path, topic: str, field: str, sentence: str) -> None:
    with pytest.raises(UsageError) as caught:
        read_arrays(run, topic, field)
    assert str(caught.value).startswith(sentence)


def test_what_cannot_be_read_is_raised_or_told(tmp_path: Path) -> None:
    shutil.copytree(GOLDEN / "foreign", tmp_path / "run")
    next((tmp_path / "run").glob("*_1.mcap")).unlink()
    with pytest.raises(UnreadableFile, match="is incomplete: "):
        read_arrays(tmp_path / "run", "/odom")
    told: list[str] = []
    found = read_arrays(tmp_path / "run", "/odom", on_missing=told.append)
    there = len(list(read_messages(tmp_path / "run", {"/odom"}, told.append)))
    assert (len(found), len(told)) == (there, 2)
