"""Topics fit into 80 columns and remain distinguishable."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotctl.cli.ui import status
from robotctl.cli.ui.status import TopicLines

SERVICE_EVENT = "/set_mode/_service_event"
SERVICE_EVENT_TYPE = "robot_controller/srv/SetMode_Event"


pytestmark = pytest.mark.usefixtures("wide_terminal")


def test_short_names_leave_the_types_their_room() -> None:
    table = TopicLines([("/odom", ""), (SERVICE_EVENT, "")])
    row = table.row(SERVICE_EVENT, SERVICE_EVENT_TYPE, 3, 0.5)
    assert row.split() == [SERVICE_EVENT, SERVICE_EVENT_TYPE, "3", "0.5"]


def test_a_long_name_takes_its_room_from_the_types() -> None:
    name = f"/demo_12345{SERVICE_EVENT}"
    table = TopicLines([("/odom", ""), (name, "")])
    row = table.row(name, SERVICE_EVENT_TYPE, 3, 0.5)
    assert row.split() == [name, "robot_contr..etMode_Event", "3", "0.5"]
    assert table.row("/odom", "nav_msgs/msg/Odometry", 3, 0.5).split()[1] == "nav_msgs/Odometry"


@given(name=st.text(max_size=100), type_name=st.text(max_size=100))
def test_every_line_has_80_columns_and_the_same_ones(name: str, type_name: str) -> None:
    table = TopicLines([(name, type_name)])
    row = table.row(name, type_name, 12_345_678, 99_999.9)
    assert len(row) == len(table.header) == 80
    assert row.endswith(" 12345678 99999.9")


def test_a_narrow_terminal_gets_narrow_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(status, "columns", lambda: 60)
    table = TopicLines([(SERVICE_EVENT, "")])
    row = table.row(SERVICE_EVENT, SERVICE_EVENT_TYPE, 3, 0.5)
    assert len(row) == len(table.header) == 60
    assert row.split()[0] == SERVICE_EVENT


@pytest.mark.parametrize(("rate_hz", "shown"), [(1e9, "1.0e+09"), (None, "unknown")])
def test_a_rate_keeps_to_its_column(rate_hz: float | None, shown: str) -> None:
    assert TopicLines([]).row("/odom", "", 1, rate_hz).endswith(f" {shown}")
