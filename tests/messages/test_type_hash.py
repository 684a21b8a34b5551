"""The hash of a type is the one that ROS computed when the type was built.

Messages of safety inputs are read whatever bytes arrive, in a limited time.
"""

from __future__ import annotations

import json
import struct
import sys
import time
from math import isnan
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotctl.kernel.safety_inputs import SafetyInput
from robotctl.messages.cdr import ENCAPSULATION
from robotctl.messages.definition import parse_definition, rihs01_hash
from robotctl.messages.inputs import MAX_STATUSES, MAX_VALUES, reader_of
from robotctl.recording.convert.sources import installed_definition
from robotctl.rerun.recording_ends import HASHES
from robotctl.testing.hearing import safety_message
from tests.support.heard_drives import EVENTS

SHARE = Path(sys.prefix) / "share"
MESSAGES = sorted(SHARE.glob("*/msg/*.json"))


def built_hash(path: Path, type_name: str) -> str:
    hashes = json.loads(path.read_text())["type_hashes"]
    return str(next(each["hash_string"] for each in hashes if each["type_name"] == type_name))


def computed(type_name: str, text: str) -> str:
    return rihs01_hash(type_name, parse_definition(type_name, text))


def test_each_installed_message_has_the_hash_that_ros_computed() -> None:
    assert len(MESSAGES) > 100
    for path in MESSAGES:
        type_name = f"{path.parts[-3]}/msg/{path.stem}"
        text = installed_definition(type_name, "")
        assert computed(type_name, text) == built_hash(path, type_name), type_name


def test_the_event_of_a_service_has_the_hash_that_ros_computed() -> None:
    for type_name, text in EVENTS.items():
        package, kind, event = type_name.split("/")
        path = SHARE / package / kind / f"{event.removesuffix('_Event')}.json"
        assert computed(type_name, text) == built_hash(path, type_name)


def test_the_types_that_a_check_reads_are_those_that_are_installed() -> None:
    for type_name, known in HASHES.items():
        text = EVENTS.get(type_name) or installed_definition(type_name, "")
        assert computed(type_name, text) == f"RIHS01_{known}", type_name


@pytest.mark.parametrize("comment", ["# said\n", "\n", "uint8 ANY=7\n"])
def test_comments_and_constants_do_not_change_it(comment: str) -> None:
    plain = "float64 x\nstring<=5 name\nbyte[3] bytes\nfloat32[<=4] more\n"
    assert computed("a/msg/T", comment + plain) == computed("a/msg/T", plain)
    assert computed("a/msg/T", "float64 y\n") != computed("a/msg/T", "float64 x\n")


HEADER = struct.pack("<4siII1s3x", ENCAPSULATION, 0, 0, 1, b"\0")
EMPTY = struct.pack("<IB3xIII", 1, 0, 0, 0, 0)
"""One diagnosis without texts, up to the number of its values."""


def value_of(kind: SafetyInput, data: bytes) -> float:
    return reader_of(kind, button=0, robot="robot")(data)[0]


@given(kind=st.sampled_from(SafetyInput), data=st.binary(max_size=200))
def test_any_bytes_are_a_value_or_unreadable(kind: SafetyInput, data: bytes) -> None:
    for each in (data, ENCAPSULATION + data, HEADER + data):
        assert isinstance(value_of(kind, each), float)


@pytest.mark.parametrize("kind", SafetyInput)
def test_a_message_that_is_cut_short_is_unreadable(kind: SafetyInput) -> None:
    data = safety_message(kind, 1.0, "motor: warm" if kind is SafetyInput.DIAGNOSTICS else "")
    assert value_of(kind, data) == 1.0
    assert isnan(value_of(kind, data[:4]))


@pytest.mark.parametrize(
    "data",
    [
        HEADER + struct.pack("<I", MAX_STATUSES + 1) + bytes(40 * MAX_STATUSES),
        HEADER + EMPTY + struct.pack("<I", MAX_VALUES + 1) + bytes(16 * MAX_VALUES),
        HEADER + EMPTY + struct.pack("<I", 0xFFFFFFFF),
    ],
)
def test_a_flood_of_diagnoses_is_unreadable_at_once(data: bytes) -> None:
    begin = time.process_time()
    assert isnan(value_of(SafetyInput.DIAGNOSTICS, data))
    assert time.process_time() - begin < 0.1
