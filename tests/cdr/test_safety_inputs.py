"""Messages of safety inputs are read whatever bytes arrive, in a limited time."""

from __future__ import annotations

import struct
import time
from math import isnan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotctl.cdr.reader import ENCAPSULATION
from robotctl.cdr.safety_inputs import MAX_STATUSES, MAX_VALUES, reader_of
from robotctl.kernel.safety_inputs import SafetyInput
from robotctl.testing.hearing import safety_message

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
