"""The types that services and actions imply have a schema and a class, but no .msg file."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from ament_index_python.packages import get_package_share_directory, get_packages_with_prefixes
from rosbags.typesys import get_types_from_msg

from robotctl.ros.messages.classes import message_class
from robotctl.ros.messages.type_definition import definition_of, texts_of, type_hash_of

FIELDS = [
    ("flag", {"type_id": 15}, "bool flag"),
    ("raw", {"type_id": 16 + 144}, "byte[] raw"),
    ("pair", {"type_id": 11 + 48, "capacity": 2}, "float64[2] pair"),
    ("few", {"type_id": 6 + 96, "capacity": 5}, "int32[<=5] few"),
    ("text", {"type_id": 17}, "string text"),
    ("short", {"type_id": 21, "string_capacity": 9}, "string<=9 short"),
    ("wide", {"type_id": 18 + 144}, "wstring[] wide"),
    (
        "names",
        {"type_id": 21 + 96, "capacity": 3, "string_capacity": 4},
        "string<=4[<=3] names",
    ),
    (
        "at",
        {"type_id": 1, "nested_type_name": "builtin_interfaces/msg/Time"},
        "builtin_interfaces/Time at",
    ),
]


def described(fields: Sequence[tuple[str, Any, str]]) -> list[dict[str, Any]]:
    blank = {"capacity": 0, "string_capacity": 0, "nested_type_name": ""}
    return [{"name": name, "type": blank | kind} for name, kind, _ in fields]


FEEDBACK = {"type_id": 1, "nested_type_name": "made_up/action/Count_Feedback"}
ACTION: dict[str, Any] = {
    "type_description": {
        "type_name": "made_up/action/Count",
        "fields": [],
    },
    "referenced_type_descriptions": [
        {
            "type_name": "made_up/action/Count_FeedbackMessage",
            "fields": described(
                [
                    (
                        "feedback",
                        {"type_id": 1, "nested_type_name": "made_up/action/Count_Feedback"},
                        "",
                    )
                ]
            ),
        },
        {"type_name": "made_up/action/Count_Feedback", "fields": described(FIELDS)},
        {
            "type_name": "builtin_interfaces/msg/Time",
            "fields": described([("sec", {"type_id": 6}, ""), ("nanosec", {"type_id": 7}, "")]),
        },
    ],
}


IMPLIED = (
    *("Count", "Count_Goal", "Count_Result", "Count_Feedback", "Count_FeedbackMessage"),
    *("Count_SendGoal", "Count_SendGoal_Request", "Count_GetResult_Event"),
)


@pytest.fixture
def made_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """An installed package with an action; no ROS wheel contains one."""
    share = tmp_path / "share"
    (share / "made_up" / "action").mkdir(parents=True)
    hashes = [{"type_name": "made_up/action/Count_FeedbackMessage", "hash_string": "RIHS01_1"}]
    description = {"type_description_msg": ACTION, "type_hashes": hashes}
    (share / "made_up" / "action" / "Count.json").write_text(json.dumps(description))
    for kind, content in (("packages", ""), ("rosidl_interfaces", "action/Count.action\n")):
        index = share / "ament_index" / "resource_index" / kind
        index.mkdir(parents=True)
        (index / "made_up").write_text(content)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    inner = ModuleType("made_up.action._count")
    for name in IMPLIED:
        setattr(inner, name, type(name, (), {"__module__": inner.__name__}))
    outer = ModuleType("made_up.action")
    outer.Count = inner.Count  # type: ignore[attr-defined]
    modules = {"made_up": ModuleType("made_up"), outer.__name__: outer, inner.__name__: inner}
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    yield
    message_class.cache_clear()
    definition_of.cache_clear()
    type_hash_of.cache_clear()


def test_the_feedback_of_an_action_has_a_definition_a_hash_and_a_class(made_up: None) -> None:
    name = "made_up/action/Count_FeedbackMessage"
    own, nested, time = definition_of(name).split("=" * 80 + "\n")
    assert own == "made_up/Count_Feedback feedback\n"
    assert nested == "MSG: made_up/Count_Feedback\n" + "".join(f"{text}\n" for *_, text in FIELDS)
    assert time == "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    assert get_types_from_msg(definition_of(name), name)
    assert type_hash_of(name) == "RIHS01_1"
    for short in IMPLIED:
        assert message_class(f"made_up/action/{short}").__name__ == short


def test_a_type_that_ros2msg_cannot_say_has_no_text() -> None:
    long_double = described([("x", {"type_id": 12}, "")])
    root = {"type_name": "a/msg/B", "fields": long_double}
    with pytest.raises(KeyError):
        texts_of("a/msg/B", {"type_description": root, "referenced_type_descriptions": []})


def test_what_is_made_from_descriptions_says_what_the_installed_files_say() -> None:
    compared = 0
    for package in get_packages_with_prefixes():
        for path in sorted((Path(get_package_share_directory(package)) / "msg").glob("*.json")):
            name = f"{package}/msg/{path.stem}"
            description = json.loads(path.read_text())["type_description_msg"]
            made = texts_of(name, description)[f"{package}/{path.stem}"]
            assert _fields(made, name) == _fields(path.with_suffix(".msg").read_text(), name)
            compared += 1
    assert compared > 100


def _fields(text: str, name: str) -> Any:
    _, fields = get_types_from_msg(text, name)[name]
    if not fields:  # an empty structure has a byte on the wire
        return [["structure_needs_at_least_one_member", [1, ["uint8", 0]]]]
    return json.loads(json.dumps(fields).replace('"char"', '"uint8"'))
