"""What `robotctl view` refuses."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from robotctl.cli.targets import launch
from tests.cli.conftest import Ran


def test_wrong_options_are_refused_at_once(cli: Callable[..., Ran]) -> None:
    ran = cli("view", "--port", "99999")
    assert ran.exit_code == 2
    assert "--port 99999" in ran.err


def test_without_the_extra_the_cure_is_told(
    cli: Callable[..., Ran], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(launch, "find_spec", lambda name: None)
    ran = cli("view")
    assert ran.exit_code == 4
    assert "pip install 'robotctl[view]'" in ran.err


def test_without_a_daemon_it_says_how_to_start_one(cli: Callable[..., Ran]) -> None:
    ran = cli("view")
    assert ran.exit_code == 3
    assert "robotctl start" in ran.err
