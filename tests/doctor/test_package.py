"""The classic mistakes of a first package are named; a healthy package has none."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from robotctl.doctor.finding import Finding, Level
from robotctl.doctor.package.package_checks import check_packages
from robotctl.errors import UnreadableFile, UsageError
from tests.support.first_package import MISTAKES, healthy

CLASSICS = {
    *("entry points", "data_files", "not sourced", "dashes", "interfaces", "depend"),
    *("executable bit", "QoS", "two rclpys", "PEP 668", "spin in a callback", "name collisions"),
}


def faults(folder: Path, **environment: str) -> list[Finding]:
    found = check_packages(folder, environment)
    return [each for each in found if each.level is not Level.OK]


def test_each_of_the_twelve_classics_is_seeded() -> None:
    assert {check for check, _ in MISTAKES.values()} == CLASSICS


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_seeded_mistake_is_named_with_its_cure_and_nothing_else(
    mistake: str, tmp_path: Path
) -> None:
    package = healthy(tmp_path)
    check, edit = MISTAKES[mistake]
    edit(package)
    found = faults(tmp_path / "src")
    assert {each.check for each in found} == {check}, found
    assert all(each.cure and "\n" not in each.text for each in found)


def test_a_healthy_workspace_gets_no_finding(tmp_path: Path) -> None:
    package = healthy(tmp_path)
    assert faults(tmp_path / "src") == []
    assert faults(package) == []


def test_a_sourced_workspace_is_healthy(tmp_path: Path) -> None:
    package = healthy(tmp_path)
    MISTAKES["built and not sourced"][1](package)
    assert faults(package, AMENT_PREFIX_PATH=f"/opt/ros:{tmp_path}/install/my_robot") == []
    assert faults(package, AMENT_PREFIX_PATH=f"{tmp_path}/install") == []
    assert [each.check for each in faults(package, AMENT_PREFIX_PATH="/opt/ros")] == ["not sourced"]


def test_our_own_package_is_healthy() -> None:
    assert faults(Path(__file__).parents[2]) == []


def test_nothing_of_the_package_is_run(tmp_path: Path) -> None:
    package = healthy(tmp_path)
    for path in package.rglob("*.py"):
        path.write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\n{path.read_text()}")
    before = set(sys.modules)
    assert faults(package) == []
    assert not (tmp_path / "ran").exists()
    assert not {name for name in set(sys.modules) - before if name.startswith("my_robot")}


@pytest.mark.parametrize(
    "hostile",
    [b"def (", b"\0", b"\xff\xfe", b"(" * 5_000, b"x = " + b"-" * 100_000 + b"1"],
    ids=["syntax", "zero", "bytes", "deep", "deeper"],
)
def test_a_file_that_is_no_python_is_named_and_the_others_are_checked(
    hostile: bytes, tmp_path: Path
) -> None:
    package = healthy(tmp_path)
    (package / "my_robot" / "odd.py").write_bytes(hostile)
    MISTAKES["a missing depend"][1](package)
    assert {each.check for each in faults(package)} == {"syntax", "depend"}


def test_a_fifo_and_a_link_to_nowhere_hold_nothing_up(tmp_path: Path) -> None:
    package = healthy(tmp_path)
    os.mkfifo(package / "my_robot" / "pipe.py")
    (package / "my_robot" / "gone.py").symlink_to(tmp_path / "nowhere")
    assert {each.check for each in faults(package)} == {"syntax"}


def test_a_sum_without_end_and_an_entity_that_grows_are_no_trap(tmp_path: Path) -> None:
    package = healthy(tmp_path)
    setup = (package / "setup.py").read_text()
    long = "'a' + " * 2_500 + "'a'"
    (package / "setup.py").write_text(f"{setup}\nlong = {long}\n")
    assert faults(package) == []
    entities = "".join(f"<!ENTITY e{level + 1} '{f'&e{level};' * 10}'>" for level in range(12))
    bomb = f"<!DOCTYPE b [<!ENTITY e0 'x'>{entities}]><package><name>&e12;</name></package>"
    (package / "package.xml").write_text(bomb)
    with pytest.raises(UnreadableFile):
        faults(package)


def test_what_is_no_package_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"no package\.xml"):
        faults(tmp_path)
    (tmp_path / "package.xml").write_text("<package><name>")
    with pytest.raises(UnreadableFile):
        faults(tmp_path)
