"""Which ROS domains are in use on this machine, and how one is reserved."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from robotctl.base import domains
from robotctl.base.domains import (
    DOMAINS,
    is_certainly_empty,
    participants_here,
    reserved_domain,
    wider_discovery,
)
from robotctl.base.errors import Refused

NEVER = 65536 // 250
"""A domain whose ports do not exist."""

OURS = 215 + 2 * (os.getpid() % 9)
OTHER = OURS + 1
"""Domains that nothing else uses: never reserved, and above the ephemeral ports of Linux."""


@pytest.fixture(autouse=True)
def two_domains(monkeypatch: pytest.MonkeyPatch) -> None:
    """Limit the reservation to two domains."""
    monkeypatch.setattr(domains, "DOMAINS", (OURS, OTHER))


@contextmanager
def participant_in(domain_id: int) -> Iterator[None]:
    """Bind the first port of a participant in the domain."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 7400 + 250 * domain_id + 10))
        yield


def test_a_domain_is_reserved_by_one_process_at_a_time() -> None:
    with reserved_domain() as first, reserved_domain() as second:
        assert {first, second} == {OURS, OTHER}
        with pytest.raises(Refused, match="every ROS domain"), reserved_domain():
            pass
    with reserved_domain() as again:
        assert again in (first, second)


def test_who_loses_the_race_for_a_domain_gets_another(monkeypatch: pytest.MonkeyPatch) -> None:
    offered = [OURS, OURS, OTHER]
    monkeypatch.setattr(domains, "_free_domain", lambda: offered.pop(0))
    with reserved_domain() as winner, reserved_domain() as loser:
        assert (winner, loser) == (OURS, OTHER)


def test_a_domain_with_a_participant_is_not_reserved() -> None:
    with participant_in(OURS):
        for _ in range(20):
            with reserved_domain() as given:
                assert given == OTHER


def test_a_reserved_domain_is_empty_until_a_participant_joins() -> None:
    with reserved_domain() as ours:
        assert is_certainly_empty(ours)
        assert participants_here(ours) == 0
        with participant_in(ours):
            assert not is_certainly_empty(ours)
            assert participants_here(ours) == 1


def test_without_a_view_of_the_ports_no_domain_is_certainly_empty(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert is_certainly_empty(NEVER)
    with monkeypatch.context() as patch:
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
        assert not is_certainly_empty(NEVER)
    monkeypatch.setattr(domains, "_TABLES", ("/proc/net/no-such-table",))
    assert not is_certainly_empty(NEVER)


def test_the_domain_of_the_environment_is_not_reserved(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(OURS))
    with reserved_domain() as given:
        assert given == OTHER


def test_domain_0_the_default_is_not_reserved() -> None:
    assert 0 not in DOMAINS
    assert max(DOMAINS) == 101


@pytest.mark.parametrize(
    ("discovery", "wider"),
    [
        ("SUBNET", "ROS_AUTOMATIC_DISCOVERY_RANGE is SUBNET"),
        ("SYSTEM_DEFAULT", "ROS_AUTOMATIC_DISCOVERY_RANGE is SYSTEM_DEFAULT"),
        ("", "ROS_AUTOMATIC_DISCOVERY_RANGE is empty"),
        ("LOCALHOST", ""),
        ("OFF", ""),
        ("subnet", ""),
    ],
)
def test_a_range_that_ros_does_not_know_is_this_machine_as_in_ros(
    discovery: str, wider: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", discovery)
    monkeypatch.delenv("ROS_STATIC_PEERS", raising=False)
    monkeypatch.delenv("ROS_DISCOVERY_SERVER", raising=False)
    assert wider_discovery() == wider


def test_a_participant_that_the_system_leaves_out_of_one_look_is_counted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    looks = iter([*["sl local_address\n"] * 3, "sl local_address\n1: 0100007F:1CF2 0:0 07\n"])
    monkeypatch.setattr(domains, "_TABLES", ("/proc/net/udp",))
    monkeypatch.setattr("pathlib.Path.read_text", lambda _: next(looks))
    assert participants_here(0) == 1
