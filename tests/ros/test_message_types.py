"""Only names of installed ROS interfaces are imported, whatever names are announced."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotctl.ros.messages import classes
from robotctl.ros.messages.classes import UnusableType, message_class, type_name_of
from robotctl.ros.messages.type_definition import definition_of, type_hash_of

HOSTILE = (
    "lib2to3/__main__/X",
    "antigravity/x/X",
    "os.path/msg/X",
    "robot_controller/__main__/X",
    "std_msgs/msg/..",
    "std_msgs/../X",
    "../std_msgs/msg/String",
    "std_msgs/msg/String\n",
    "std_msgs/msg/String_Event",
    "std_msgs/msg/__class__",
    "std_msgs/__init__/String",
    "std_msgs/String",
    "std__msgs/msg/String",
    "STD_MSGS/msg/String",
    "//",
    "",
    f"std_msgs/msg/{'S' * 300}",
)
UNLISTED = ("os/msg/Path", "robotctl/msg/String", "std_msgs/msg/Nope", "std_srvs/srv/Nope_Event")


@pytest.mark.parametrize("name", HOSTILE + UNLISTED)
def test_no_other_name_is_imported(name: str) -> None:
    before = set(sys.modules)
    expected = "not installed" if name in UNLISTED else "not the name of a ROS type"
    with pytest.raises(UnusableType, match=expected):
        message_class(name)
    assert (definition_of(name), type_hash_of(name)) == ("", "")
    assert set(sys.modules) == before


@given(st.text() | st.from_regex(r"[a-z_.]{1,9}/(msg|srv|action|__main__|x)/[A-Za-z_.]{1,9}"))
def test_any_text_is_a_type_or_is_named(name: str) -> None:
    before = set(sys.modules)
    with pytest.raises(UnusableType):
        message_class(name)
    assert set(sys.modules) == before


def test_what_a_service_implies_is_found_through_it() -> None:
    from std_srvs.srv import Trigger_Event, Trigger_Request

    assert message_class("std_srvs/srv/Trigger_Event") is Trigger_Event
    assert message_class("std_srvs/srv/Trigger_Request") is Trigger_Request
    assert type_name_of(Trigger_Event) == "std_srvs/srv/Trigger_Event"


@pytest.mark.parametrize(
    "raised", ["SystemExit(3)", "KeyboardInterrupt()", "RecursionError()", "MemoryError()", "1 / 0"]
)
def test_what_loading_a_type_raises_is_a_reason_and_no_more(
    raised: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    index = tmp_path / "share" / "ament_index" / "resource_index" / "rosidl_interfaces"
    index.mkdir(parents=True)
    (index / "broken_msgs").write_text("msg/Broken.msg\n")
    package = tmp_path / "broken_msgs" / "msg"
    package.mkdir(parents=True)
    text = f"raise {raised}" if "(" in raised else raised
    (package / "__init__.py").write_text(f"{text}\n")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(classes, "_is_ctrl_c", lambda: False)
    with pytest.raises(UnusableType, match="cannot be loaded"):
        message_class("broken_msgs/msg/Broken")
    for name in [name for name in sys.modules if name.startswith("broken_msgs")]:
        del sys.modules[name]
