"""Kernel values survive JSON bit for bit; any other text is a ValueError.

The values of the kernel are immutable: a State is replaced as a whole.
"""

from __future__ import annotations

import json
import struct
from dataclasses import MISSING, FrozenInstanceError, dataclass, fields, is_dataclass
from enum import Enum
from importlib import import_module
from math import inf, nan
from pkgutil import iter_modules
from typing import Any, cast, get_args

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robotctl import kernel
from robotctl.kernel.codec import Snapshot, finite_or_none, from_json, to_json
from robotctl.kernel.constants import TWIST
from robotctl.kernel.course import PLAIN
from robotctl.kernel.drive import Drive
from robotctl.kernel.geometry import ORIGIN
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams
from robotctl.kernel.state import Health, State
from robotctl.kernel.types import (
    ZERO,
    BatteryReceived,
    CommandListenersSeen,
    DriveEnded,
    DriveReport,
    DriveRequested,
    Effect,
    Event,
    GuardedCommandReceived,
    HoldReceived,
    LatchEmergencyStop,
    LeaseLost,
    LeaseRequested,
    ModeChanged,
    ModeRequested,
    Odometry,
    OdometrySourceFound,
    OdomReceived,
    ParameterChanged,
    PublishTwist,
    ReleaseEmergencyStop,
    Reply,
    ResetRequested,
    SafetyInputReceived,
    ScanReceived,
    Tick,
    changed,
)
from robotctl.testing.kernels import moving
from tests.kernel import strategies
from tests.support.cases import for_each

EVENTS = strategies.event(strategies.INT64, strategies.INT64)
FLOAT = strategies.ANY_FLOAT
EFFECTS: dict[type, st.SearchStrategy[Any]] = {
    PublishTwist: st.builds(PublishTwist, strategies.TWIST),
    ModeChanged: st.builds(
        ModeChanged, st.sampled_from(Mode), st.sampled_from(Mode), st.text(max_size=20)
    ),
    LatchEmergencyStop: st.builds(LatchEmergencyStop, st.text(max_size=20)),
    ReleaseEmergencyStop: st.builds(ReleaseEmergencyStop),
    Reply: st.builds(Reply, strategies.INT64, st.booleans(), st.text(), st.sampled_from(Mode)),
    ParameterChanged: st.builds(ParameterChanged, *[st.text(max_size=20)] * 4),
    DriveEnded: st.builds(
        DriveEnded,
        strategies.INT64,
        st.booleans(),
        st.text(max_size=20),
        st.builds(DriveReport, strategies.INT64, FLOAT, FLOAT, FLOAT, FLOAT),
    ),
}


def bits(value: Any) -> Any:
    """Return the value with its types and every float as its bits; all NaN are equal."""
    if isinstance(value, Enum):
        return value
    if isinstance(value, float):
        return "nan" if value != value else struct.pack("<d", value)
    if isinstance(value, tuple):
        return tuple(map(bits, value))
    if is_dataclass(value):
        return type(value), tuple(bits(getattr(value, field.name)) for field in fields(value))
    return type(value), value


def test_every_kind_of_effect_is_tried() -> None:
    assert set(EFFECTS) == set(get_args(Effect))


@given(st.one_of(EVENTS, *EFFECTS.values()))
@settings(max_examples=500)
def test_every_event_and_effect_survives_bit_for_bit(value: Any) -> None:
    text = to_json(value)
    assert text.isascii()
    assert bits(from_json(type(value), text)) == bits(value)


@given(st.lists(EVENTS, max_size=30))
@settings(max_examples=100)
def test_every_state_survives_bit_for_bit(events: list[Event]) -> None:
    kernel = Kernel(KernelParams(), moving(ticks=5).state)
    for event in events:
        kernel.step(event)
        again = from_json(State, to_json(kernel.state))
        assert bits(again) == bits(kernel.state)
    snapshot = Snapshot("test", kernel.params, kernel.state)
    assert bits(from_json(Snapshot, to_json(snapshot))) == bits(snapshot)


def test_the_json_is_strict() -> None:
    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is not JSON")

    text = to_json(BatteryReceived(1, float("nan")))
    assert json.loads(text, parse_constant=refuse) == {
        "t_ns": 1,
        "level": "nan",
        "publisher": "",
        "sequence": 0,
    }


@for_each(
    ("kind", "text"),
    [
        (Tick, ""),
        (Tick, "null"),
        (Tick, "[]"),
        (Tick, "{}"),
        (Tick, '{"t_ns": 1.5, "missed": 0}'),
        (Tick, '{"t_ns": true, "missed": 0}'),
        (Tick, '{"t_ns": "1", "missed": 0}'),
        (BatteryReceived, '{"t_ns": 1, "level": "full"}'),
        (BatteryReceived, '{"t_ns": 1, "level": null}'),
        (BatteryReceived, '{"t_ns": 1, "level": 1' + "0" * 400 + "}"),
        (OdomReceived, '{"t_ns": 1, "odometry": 3}'),
        (ModeRequested, '{"t_ns": 1, "request_id": 1, "requested": 1, "source": 7}'),
        (PublishTwist, "[" * 100_000),
        (ModeChanged, '{"previous": 9, "mode": 0, "reason": ""}'),
        (State, "[]"),
        (State, '"mode"'),
        (State, '{"mode": 9}'),
        (Snapshot, '{"made_by": "test", "params": {}}'),
    ],
)
def test_what_is_not_a_kernel_value_is_a_value_error(kind: type, text: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        from_json(kind, text)


@dataclass(frozen=True, slots=True)
class Tuples:
    one: tuple[float]
    three: tuple[int, str, float]
    any_number: tuple[int, ...] = ()


@for_each("values", [(), (1,), (1, 2), (1, 2, 3)])
def test_a_tuple_keeps_its_length_and_types(values: tuple[int, ...]) -> None:
    tuples = Tuples((0.5,), (1, "a", 2.0), values)
    assert bits(from_json(Tuples, to_json(tuples))) == bits(tuples)


@for_each(
    "text",
    [
        '{"one":[],"three":[1,"a",2.0]}',
        '{"one":[0.5,0.5],"three":[1,"a",2.0]}',
        '{"one":[0.5],"three":[1,"a"]}',
        '{"one":[0.5],"three":[1,"a",2.0,3]}',
        '{"one":[0.5],"three":["a",1,2.0]}',
    ],
)
def test_a_tuple_of_another_length_or_type_is_a_value_error(text: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        from_json(Tuples, text)


def test_an_error_quotes_the_begin_of_the_text() -> None:
    text = json.dumps(["x" * 200])
    with pytest.raises(ValueError, match="not a") as caught:
        from_json(Tick, text)
    assert str(caught.value).endswith(f": {text[:80]}")


def test_a_field_that_an_older_version_did_not_write_takes_its_default() -> None:
    assert from_json(Tick, '{"t_ns": 7}') == Tick(7, missed=0)
    assert from_json(State, '{"mode": 0, "health": {}}') == State()
    written = json.loads(to_json(Snapshot("test", KernelParams(), moving(ticks=5).state)))
    del written["params"]["limits"], written["state"]["health"]["odometry"]
    read = from_json(Snapshot, json.dumps(written))
    assert read.params == KernelParams()
    assert read.state.health.odometry is None
    assert read.state.mode is Mode.MOVING


def test_what_an_older_version_did_not_write_is_unknown_or_nothing() -> None:
    """A changed default would change how old journals are read."""
    assert to_json(from_json(State, "{}")) == (
        '{"mode":0,"phase":"standing","reason":"started","cause":null,'
        '"command":{"linear":0.0,"angular":0.0},"tick_t_ns":null,"health":{'
        '"odometry":null,"odometry_t_ns":0,"odometry_stamp_ns":0,"odometry_fault":"",'
        '"battery_level":null,"battery_t_ns":0,"foreign_publishers":[],"reported":[],'
        '"path_error_m":0.0,"tick_gap_s":0.0,'
        '"odometry_sources":{"followed":0,"names":[],"dropped":0,"second":null,"frames":[]},'
        '"command_topic":{"foreign_t_ns":null,"foreign_by":"","listeners":null,"other_types":[],'
        '"type_name":"geometry_msgs/msg/Twist"},'
        '"stalls":{"count":0,"last_t_ns":0,"last_s":0.0,"detail":""},"battery_in_percent":false,"inputs":[],"fence_origin":null,"scan":null,"lifecycle":"active"},'
        '"drive":null,"stop_reason":"","waiting":[],"idle_t_ns":null,"silent":false,"lease":null,"guarded":null}'
    )
    drive = '{"request_id":1,"pattern":{},"laps":0,"origin":{}}'
    assert to_json(from_json(Drive, drive)) == (
        '{"request_id":1,"pattern":{"kind":"square","size_m":1.0,"speed_mps":0.5},"laps":0,'
        '"origin":{"x":0.0,"y":0.0,"theta":0.0},'
        '"progress":{"laps":0,"segment":0,"length":0.0,"speed":0.0,"settling_s":0.0,'
        '"closure_m":"nan","ahead":0.0,"lead_speed":0.0,"rates":[],"accel":0.0},"score":{"samples":0,"squared_error_sum":0.0,"max_error_m":0.0,'
        '"error_m":0.0,"distance_m":0.0,"squared_heading_sum":0.0,"max_heading_rad":0.0},"course":{"corner_m":0.1,"angle_rad":1.5707963267948966,'
        '"reverse":false,"open_loop":false,"waypoints":[],"frame":"start",'
        '"held":null},"begin_t_ns":0}'
    )
    sample = Odometry(ORIGIN, ZERO, 1)
    text = '{"t_ns":7,"odometry":{"pose":{},"velocity":{},"stamp_ns":1}}'
    assert from_json(OdomReceived, text) == OdomReceived(7, sample, source=0, sequence=0)


WITHOUT = {
    Tick: {"missed": 0},
    OdomReceived: {"source": 0, "sequence": 0},
    OdometrySourceFound: {"frame_id": ""},
    BatteryReceived: {"publisher": "", "sequence": 0},
    SafetyInputReceived: {"detail": "", "publisher": "", "sequence": 0},
    ScanReceived: {"publisher": "", "sequence": 0},
    GuardedCommandReceived: {"publisher": "", "sequence": 0},
    ModeRequested: {"client": 0, "reason": "", "remote": False},
    ResetRequested: {"reason": ""},
    DriveRequested: {"client": 0, "reason": "", "course": PLAIN, "remote": False},
    HoldReceived: {"client": 0},
    LeaseRequested: {"reason": ""},
    LeaseLost: {"how": "its connection closed"},
    CommandListenersSeen: {"type_name": TWIST},
}
"""The values of the fields that were added after the first version, in events without them."""


@for_each("kind", get_args(Event))
def test_an_event_of_an_older_version_has_the_default_of_each_field_that_it_lacks(
    kind: type,
) -> None:
    defaults = {field.name: field.default for field in fields(kind) if field.default is not MISSING}
    assert defaults == WITHOUT.get(kind, {})


def test_what_is_no_number_is_none_and_a_number_stays_what_it_is() -> None:
    told = [finite_or_none(value) for value in (1.5, 0.0, nan, inf, -inf)]
    assert told == [1.5, 0.0, None, None, None]


def classes() -> list[type]:
    """Return every class of the kernel that is or should be a dataclass: it declares fields."""
    modules = [
        import_module(f"{kernel.__name__}.{each.name}") for each in iter_modules(kernel.__path__)
    ]
    return sorted(
        {
            value
            for module in modules
            for value in vars(module).values()
            if isinstance(value, type)
            and value.__module__.startswith(kernel.__name__)
            and not issubclass(value, tuple)
            and (is_dataclass(value) or "__annotations__" in vars(value))
        },
        key=lambda kind: kind.__qualname__,
    )


def values() -> list[type]:
    """Return every dataclass of the kernel."""
    return [each for each in classes() if is_dataclass(each)]


def test_whatever_declares_fields_and_every_event_and_effect_is_a_value() -> None:
    wanted = {*classes(), *get_args(Event), *get_args(Effect)}
    assert sorted(each.__name__ for each in wanted if not is_dataclass(each)) == []


def test_a_name_of_the_package_is_loaded_on_first_use() -> None:
    """Otherwise a command that needs no kernel would load all of it."""
    assert set(kernel.__all__).isdisjoint(vars(kernel))
    assert all(getattr(kernel, name).__name__ for name in ("Kernel", "Tick", "to_json"))


def test_every_value_is_found() -> None:
    names = {kind.__name__ for kind in values()}
    assert names > {"State", "Health", "KernelParams", "Tick", "Reply", "Drive", "Line", "Rule"}


@for_each("kind", values())
def test_a_value_cannot_be_changed(kind: type) -> None:
    assert vars(kind)["__dataclass_params__"].frozen
    value: object = object.__new__(kind)
    for field in fields(kind):
        with pytest.raises(FrozenInstanceError):
            setattr(value, field.name, 0)


@for_each("kind", values())
def test_a_value_has_its_fields_and_no_more(kind: type) -> None:
    if kind in (State, Health, Drive):  # copied by `changed`, through their dictionaries
        value = object.__new__(kind)
        vars(value).update(dict.fromkeys(kind.__dataclass_fields__))
        with pytest.raises(AssertionError, match="another"):
            changed(cast(Any, value), another=0)
    else:
        assert not hasattr(object.__new__(kind), "__dict__")
