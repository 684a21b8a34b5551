"""A check changes how often Python searches for reference cycles only while it runs."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import pytest

from robotctl.rerun.gc_pacing import NEW_OBJECTS, rare_collections


@pytest.fixture(autouse=True)
def _restored() -> Iterator[None]:
    before = gc.get_threshold()
    yield
    gc.set_threshold(*before)


def test_python_searches_rarely_only_in_the_block() -> None:
    @rare_collections()
    def fail() -> None:
        assert gc.get_threshold() == (NEW_OBJECTS, 11, 12)
        raise ValueError("ended")

    gc.set_threshold(700, 11, 12)
    with pytest.raises(ValueError, match="ended"):
        fail()
    assert gc.get_threshold() == (700, 11, 12)


@pytest.mark.parametrize("wanted", [0, 3 * NEW_OBJECTS])
def test_who_searches_never_or_more_rarely_keeps_that(wanted: int) -> None:
    gc.set_threshold(wanted, 11, 12)
    with rare_collections():
        assert gc.get_threshold() == (wanted, 11, 12)
    assert gc.get_threshold() == (wanted, 11, 12)
