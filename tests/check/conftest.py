"""A drive that the tests of checks share."""

from __future__ import annotations

import pytest

from robotctl.testing.drives import Written, drive


@pytest.fixture(scope="session")
def drive_of_3_s() -> list[Written]:
    return drive(3.0, snapshots_s=(0.0, 1.5))
