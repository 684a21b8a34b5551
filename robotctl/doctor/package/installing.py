"""What `colcon build` installs: entry points, data files, executables, interfaces."""

from __future__ import annotations

import ast
import os
import re
from collections.abc import Iterator
from pathlib import Path

from robotctl.doctor.finding import Finding, fault, warning
from robotctl.doctor.package.constants import keyword, texts_within
from robotctl.doctor.package.package_files import Package

DATA_FOLDERS = ("launch", "config", "params", "urdf", "rviz", "worlds", "maps", "meshes")
"""Folders that a running node or launch file looks for in the share folder."""

ENTRY_POINT = re.compile(r"\s*([^=\s]+)\s*=\s*([\w.]+)\s*:\s*(\w+)\s*")

INTERFACES = {"msg": ".msg", "srv": ".srv", "action": ".action"}

_PROGRAMS = re.compile(r"install\s*\(\s*PROGRAMS\s+([^)]*?)\s+DESTINATION", re.IGNORECASE)


def entry_points(package: Package) -> Iterator[tuple[str, str, str]]:
    """Yield the executables of setup.py: name, module, function."""
    given = None if package.setup is None else keyword(package.setup.call, "entry_points")
    if package.setup is None or not isinstance(given, ast.Dict):
        return
    for key, value in zip(given.keys, given.values, strict=True):
        if isinstance(key, ast.Constant) and key.value == "console_scripts":
            for text in texts_within(value, package.setup.names):
                if match := ENTRY_POINT.fullmatch(text):
                    yield match[1], match[2], match[3]


def check_entry_points(package: Package) -> Iterator[Finding]:
    """An executable names a function that exists; each node with a `main` is an executable."""
    check = "entry points"
    if not package.is_python or package.setup is None:
        return
    points = list(entry_points(package))
    for name, module, function in points:
        place = _file_of(package, module)
        if place is None:
            if module.split(".")[0] == package.name:
                yield fault(
                    check,
                    f"setup.py: {name} names the module {module}, which does not exist",
                    "name it as PACKAGE.FILE:FUNCTION, with the name of its file without .py",
                )
        elif function not in _top_level(package.modules[place]):
            yield fault(
                check,
                f"setup.py: {name} names {function}, which {place} does not define",
                f"define {function}() at the top level of {place}",
            )
    known = {_file_of(package, module) for _, module, _ in points}
    for path, tree in package.modules.items():
        if path.parts[0] == package.name and path not in known and _is_node_program(tree):
            yield warning(
                check,
                f"{path} has a main() with rclpy.init, but setup.py names no executable for it",
                f"add to console_scripts: '{path.stem} = {_module_of(path)}:main'",
            )
    wanted = f"$base/lib/{package.name}"
    places = {
        package.config.get((section, name))
        for section, name in (("develop", "script_dir"), ("install", "install_scripts"))
    }
    dashed = any("-" in key for section, key in package.config if section in ("develop", "install"))
    if points and places != {wanted} and not dashed:
        yield fault(
            check,
            f"setup.cfg does not put the executables into lib/{package.name}: ros2 run finds none",
            f"[develop] script_dir={wanted} and [install] install_scripts={wanted}",
        )


def check_data_files(package: Package) -> Iterator[Finding]:
    """Launch files and the like, package.xml and the marker of the package are installed."""
    check = "data_files"
    if not package.is_python or package.setup is None:
        return
    given = keyword(package.setup.call, "data_files")
    told = set() if given is None else set(texts_within(given, package.setup.names))
    for needed in (f"resource/{package.name}", "package.xml"):
        if needed not in told:
            yield fault(
                check,
                f"setup.py does not install {needed}: ROS does not find the package",
                "add it to data_files of setup.py, as ros2 pkg create does",
            )
    if not (package.folder / "resource" / package.name).is_file():
        text = f"there is no file resource/{package.name}, the marker of the package"
        yield fault(check, text, f"touch resource/{package.name}")
    named = {part for text in told for part in text.split("/")}
    for folder in DATA_FOLDERS:
        there = [each for each in package.files if each.parts[0] == folder and len(each.parts) > 1]
        if there and folder not in named:
            yield fault(
                check,
                f"setup.py does not install {folder}/ ({there[0].name}): nothing finds it",
                f"add to data_files: ('share/{package.name}/{folder}', glob('{folder}/*'))",
            )


def check_interfaces(package: Package) -> Iterator[Finding]:
    """Interfaces are in a package that generates code for them."""
    found = [
        each
        for each in package.files
        if len(each.parts) == 2 and INTERFACES.get(each.parts[0]) == each.suffix
    ]
    if not found:
        return
    if package.is_python:
        yield fault(
            "interfaces",
            f"{found[0]} is in an ament_python package, which generates no code for it",
            f"move it into a package of type ament_cmake, such as {package.name}_interfaces",
        )
        return
    for each in found:
        if each.name not in package.cmake and "GLOB" not in package.cmake:
            yield fault(
                "interfaces",
                f"CMakeLists.txt does not name {each}: no code is generated for it",
                "add it to rosidl_generate_interfaces",
            )


def check_executable_bit(package: Package) -> Iterator[Finding]:
    """What CMake installs as a program may be executed, and says by which interpreter."""
    for match in _PROGRAMS.finditer(package.cmake):
        for word in match[1].split():
            path = package.folder / word.strip('"')
            if "$" in word or not path.is_file():
                continue
            if not os.access(path, os.X_OK):
                yield fault(
                    "executable bit",
                    f"{word} is installed as a program, but may not be executed",
                    f"chmod +x {word}",
                )
            with path.open("rb") as stream:
                if path.suffix == ".py" and stream.read(2) != b"#!":
                    yield fault(
                        "executable bit",
                        f"{word} does not begin with #!: the shell would run it, not Python",
                        "let it begin with: #!/usr/bin/env python3",
                    )


def _file_of(package: Package, module: str) -> Path | None:
    base = Path(*module.split("."))
    places = (base.with_suffix(".py"), base / "__init__.py")
    return next((each for each in places if each in package.modules), None)


def _module_of(path: Path) -> str:
    return ".".join(path.with_suffix("").parts)


def _top_level(tree: ast.Module) -> set[str]:
    """Return the names that a module defines or imports; those in a branch, too."""
    found: set[str] = set()
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name):
                if node in tree.body:
                    found.add(name)
            case ast.ImportFrom(names=aliases) | ast.Import(names=aliases):
                found |= {alias.asname or alias.name for alias in aliases}
            case ast.Assign(targets=targets):
                found |= {target.id for target in targets if isinstance(target, ast.Name)}
    return found


def _is_node_program(tree: ast.Module) -> bool:
    """Return whether the module has a main() that begins with rclpy.init()."""
    mains = [
        each for each in tree.body if isinstance(each, ast.FunctionDef) and each.name == "main"
    ]
    return any(
        isinstance(node, ast.Attribute) and node.attr == "init" and _is_rclpy(node.value)
        for main in mains
        for node in ast.walk(main)
    )


def _is_rclpy(node: ast.expr) -> bool:
    return isinstance(node, ast.Name) and node.id == "rclpy"
