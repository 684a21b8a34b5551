"""A session in a namespace, as the roles of a daemon have it."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import ExitStack

import pytest

from robotctl.ros.session import Session, ros_session


@pytest.fixture
async def session(domain_id: int) -> AsyncIterator[Session]:
    """A session like the daemon's, in a namespace of its own."""
    with ExitStack() as at_end:
        async with ros_session(domain_id=domain_id, namespace="/r2", at_end=at_end) as made:
            yield made
