"""Who may import whom, read from the source: the arrows of docs/architecture.md."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import robotctl

ROOT = Path(robotctl.__file__).parent

BOTTOM = {
    *("errors", "paths", "trust", "config", "environment", "domains", "processes", "streams"),
    *("printable", "regular_file", "__init__"),
}
"""Modules beside the packages, below all of them but the kernel."""

ALLOWED: dict[str, set[str]] = {
    "kernel": set(),
    "sim": {"kernel"},
    "ros": {"kernel", "sim", *BOTTOM},
    "recording": {"kernel", *BOTTOM},
    "ipc": {"kernel", *BOTTOM},
    "replay": {"kernel", "sim", "ros", "recording", "ipc", *BOTTOM},
    "daemon": {"kernel", "sim", "ros", "recording", "ipc", "replay", *BOTTOM},
    "cli": {"kernel", "sim", "ros", "recording", "ipc", "replay", "daemon", *BOTTOM},
}
"""What each package may import of robotctl beside itself; `testing` may import all."""

ROS_MODULES = {"rclpy", "ament_index_python", "rosidl_runtime_py", "robot_controller"}
MESSAGE_SUFFIXES = ("_msgs", "_interfaces", "_srvs")
PROTOCOL_MAY = {"errors", "paths", "trust", "ipc.protocol", "ipc.peer"}


def modules(package: str) -> list[Path]:
    return sorted((ROOT / package).rglob("*.py"))


def imports(path: Path) -> Iterator[str]:
    """Yield the full name of every module that the file imports, also within functions."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import"
            assert node.module is not None
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield inner if source_of(inner) else node.module


def source_of(name: str) -> Path | None:
    """Return the file of a module of robotctl."""
    path = ROOT.parent.joinpath(*name.split("."))
    return next(filter(Path.is_file, (path.with_suffix(".py"), path / "__init__.py")), None)


def own_imports(path: Path) -> set[str]:
    """Return what the file imports of robotctl, as `package.module`."""
    names = {"robotctl.__init__" if name == "robotctl" else name for name in imports(path)}
    return {name.removeprefix("robotctl.") for name in names if name.startswith("robotctl.")}


def foreign_imports(path: Path) -> set[str]:
    """Return the top-level names that the file imports and that are not of robotctl."""
    return {name.split(".")[0] for name in imports(path)} - {"robotctl"}


def is_ros(name: str) -> bool:
    return name in ROS_MODULES or name.endswith(MESSAGE_SUFFIXES)


def test_the_map_names_every_package() -> None:
    packages = {path.parent.name for path in ROOT.glob("*/__init__.py")}
    assert packages <= {*ALLOWED, "testing"}


@pytest.mark.parametrize("package", ALLOWED)
def test_imports_point_in_one_direction(package: str) -> None:
    assert package in ("replay", "daemon") or modules(package)
    for path in modules(package):
        used = {name.split(".")[0] for name in own_imports(path)}
        assert used <= {package, *ALLOWED[package]}, path.relative_to(ROOT)


@pytest.mark.parametrize("module", sorted(BOTTOM - {"config"}))
def test_the_modules_at_the_bottom_import_nothing_above_them(module: str) -> None:
    path = ROOT / f"{module}.py"
    used = {name.split(".")[0] for name in own_imports(path)} if path.exists() else set()
    assert used <= BOTTOM - {"config"}


def test_the_configuration_knows_only_what_it_configures() -> None:
    used = {name.split(".")[0] for name in own_imports(ROOT / "config.py")}
    assert used <= {"errors", "kernel", "regular_file", "sim"}


def test_the_kernel_is_pure() -> None:
    """No clock, no file, no loop, no log, no chance; nothing but the standard library."""
    impure = {
        *("asyncio", "logging", "time", "datetime", "os", "io", "pathlib", "random", "secrets"),
        *("socket", "subprocess", "sys", "tempfile", "threading", "uuid", "warnings"),
    }
    for path in modules("kernel"):
        used = foreign_imports(path)
        assert used <= set(sys.stdlib_module_names), path.name
        assert not used & impure, path.name


def test_the_kernel_opens_nothing_and_prints_nothing() -> None:
    for path in modules("kernel"):
        names = {
            node.id
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            if isinstance(node, ast.Name)
        }
        assert not names & {"open", "print", "input", "hash", "id", "set", "globals"}, path.name


def test_only_the_ros_package_imports_ros() -> None:
    for path in sorted(ROOT.rglob("*.py")):
        if path.is_relative_to(ROOT / "ros") or path.is_relative_to(ROOT / "testing"):
            continue
        assert not {name for name in foreign_imports(path) if is_ros(name)}, path.relative_to(ROOT)


def test_the_executor_stands_alone() -> None:
    """It can be lifted out of robotctl with the files that it needs, all beside it."""
    needed, waiting = set(), ["ros.executor"]
    while waiting:
        name = waiting.pop()
        if name in needed:
            continue
        needed.add(name)
        path = source_of(f"robotctl.{name}")
        assert path is not None
        waiting += own_imports(path)
    assert {name.split(".")[0] for name in needed} == {"ros"}


@pytest.mark.parametrize("module", ["ipc.protocol", "ipc.client", "ipc.peer"])
def test_the_client_needs_only_the_standard_library(module: str) -> None:
    path = ROOT.joinpath(*module.split(".")).with_suffix(".py")
    assert foreign_imports(path) <= set(sys.stdlib_module_names)
    assert own_imports(path) <= PROTOCOL_MAY


def test_importing_the_kernel_brings_no_loop_and_no_ros() -> None:
    program = (
        "import sys, robotctl.kernel.kernel, robotctl.kernel.codec, robotctl.kernel.snapshot\n"
        "print(*sorted({name.split('.')[0] for name in sys.modules}))"
    )
    result = subprocess.run(
        [sys.executable, "-S", "-c", program],
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
        cwd=ROOT.parent,
    )
    loaded = set(result.stdout.split())
    assert "robotctl" in loaded
    assert not loaded & {"asyncio", "rclpy", "msgspec", "rich", "yaml", "logging"}
