"""The hash of a type is the one that ROS computed when the type was built."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from robotctl.cdr.definition import parse_definition
from robotctl.cdr.type_hash import rihs01_hash
from robotctl.recording.convert.installed_definition import installed_definition
from robotctl.rerun.recording_ends import HASHES
from tests.support.heard_drives import EVENTS

SHARE = Path(sys.prefix) / "share"
MESSAGES = sorted(SHARE.glob("*/msg/*.json"))


def built_hash(path: Path, type_name: str) -> str:
    hashes = json.loads(path.read_text())["type_hashes"]
    return str(next(each["hash_string"] for each in hashes if each["type_name"] == type_name))


def computed(type_name: str, text: str) -> str:
    return rihs01_hash(type_name, parse_definition(type_name, text))


def test_each_installed_message_has_the_hash_that_ros_computed() -> None:
    assert len(MESSAGES) > 100
    for path in MESSAGES:
        type_name = f"{path.parts[-3]}/msg/{path.stem}"
        text = installed_definition(type_name, "")
        assert computed(type_name, text) == built_hash(path, type_name), type_name


def test_the_event_of_a_service_has_the_hash_that_ros_computed() -> None:
    for type_name, text in EVENTS.items():
        package, kind, event = type_name.split("/")
        path = SHARE / package / kind / f"{event.removesuffix('_Event')}.json"
        assert computed(type_name, text) == built_hash(path, type_name)


def test_the_types_that_a_check_reads_are_those_that_are_installed() -> None:
    for type_name, known in HASHES.items():
        text = EVENTS.get(type_name) or installed_definition(type_name, "")
        assert computed(type_name, text) == f"RIHS01_{known}", type_name


@pytest.mark.parametrize("comment", ["# said\n", "\n", "uint8 ANY=7\n"])
def test_comments_and_constants_do_not_change_it(comment: str) -> None:
    plain = "float64 x\nstring<=5 name\nbyte[3] bytes\nfloat32[<=4] more\n"
    assert computed("a/msg/T", comment + plain) == computed("a/msg/T", plain)
    assert computed("a/msg/T", "float64 y\n") != computed("a/msg/T", "float64 x\n")
