from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from robotctl.base.store import open_store
from robotctl.base.store.objects import ObjectStore
from tests.support.stores import FaultyBucket, environment, serving


@pytest.fixture(params=["s3", "folder"])
def store(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> ObjectStore:
    """An empty store of each kind."""
    if request.param == "folder":
        return open_store(str(tmp_path / "store"))
    for name, value in environment(request.getfixturevalue("s3_endpoint")).items():
        monkeypatch.setenv(name, value)
    return open_store(f"s3://robots/{tmp_path.name}")


@pytest.fixture
def bucket(monkeypatch: pytest.MonkeyPatch) -> Iterator[FaultyBucket]:
    with serving(monkeypatch) as served:
        yield served
