"""An object that is made quickly is the object that its frozen dataclass would make."""

from __future__ import annotations

import copy
import pickle
from dataclasses import FrozenInstanceError, asdict, dataclass, fields, replace

import pytest

from robotctl.kernel.quick_init import maker, quick_init


@dataclass(frozen=True, slots=True)
class _Plain:
    first: float
    second: str = "two"
    third: tuple[int, ...] = ()


@quick_init
@dataclass(frozen=True, slots=True)
class _Quick:
    first: float
    second: str = "two"
    third: tuple[int, ...] = ()


@pytest.mark.parametrize(
    ("given", "named"),
    [((1.5,), {}), ((1.5, "b", (3,)), {}), ((), {"third": (7,), "first": 0.0})],
)
def test_it_has_the_same_values_and_the_same_defaults(
    given: tuple[float], named: dict[str, float]
) -> None:
    made = _Quick(*given, **named)  # type: ignore[arg-type]
    assert type(made) is _Quick
    assert asdict(made) == asdict(_Plain(*given, **named))  # type: ignore[arg-type]
    assert repr(made) == repr(_Plain(*given, **named)).replace("_Plain", "_Quick")  # type: ignore[arg-type]


def test_it_is_frozen_and_has_no_other_attributes() -> None:
    made = _Quick(1.0)
    with pytest.raises(FrozenInstanceError):
        made.first = 2.0  # type: ignore[misc]
    with pytest.raises(AttributeError):
        object.__setattr__(made, "other", 2.0)


def test_it_is_equal_hashed_replaced_copied_and_pickled_as_before() -> None:
    made = _Quick(1.0, third=(2,))
    for other in (replace(made, second="two"), copy.copy(made), pickle.loads(pickle.dumps(made))):
        assert other == made
        assert hash(other) == hash(made)
    assert replace(made, first=3.0) == _Quick(3.0, third=(2,))
    assert [field.name for field in fields(made)] == ["first", "second", "third"]


def test_a_wrong_argument_is_refused() -> None:
    with pytest.raises(TypeError, match="first"):
        _Quick()  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="fourth"):
        _Quick(1.0, fourth=2)  # type: ignore[call-arg]


def test_its_maker_makes_the_same_object_and_refuses_the_same_arguments() -> None:
    make = maker(_Quick)
    assert make(1.0, third=(2,)) == _Quick(1.0, third=(2,))
    assert type(make(1.0)) is _Quick
    with pytest.raises(TypeError, match="first"):
        make()  # type: ignore[call-arg]
