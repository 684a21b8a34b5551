"""Reading a package: package.xml, setup.py, setup.cfg, CMakeLists.txt and its Python files."""

from __future__ import annotations

import ast
import configparser
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

from robotctl.doctor.package.constants import assigned_texts, called, calls
from robotctl.errors import UnreadableFile, UsageError
from robotctl.regular_file import open_regular

MAX_BYTES: Final = 1_000_000
"""Larger files are not sources that a person wrote."""

MAX_FILES: Final = 2_000

BUILT = {"build", "install", "log", "__pycache__", "node_modules", "venv", "site-packages"}
"""Folders of what tools made; those that begin with a dot are left out, too."""

NEVER_INSTALLED = {"test", "tests", "benchmarks"}
"""Folders whose programs run where they are developed, and may do odd things on purpose."""

_COMMENT = re.compile(r"#.*")


@dataclass(frozen=True, slots=True)
class Setup:
    """The call of `setup` in setup.py, and the texts that names have there."""

    call: ast.Call
    names: dict[str, str]


@dataclass(frozen=True, slots=True)
class Package:
    """One package, as its files say; all paths but `folder` are relative to it.

    `ros_modules` are those of `modules` that name rclpy, `unread` the files that are no Python.
    `config` is setup.cfg by section and key, `cmake` CMakeLists.txt without comments.
    """

    folder: Path
    name: str
    build_type: str
    depends: frozenset[str]
    setup: Setup | None
    config: dict[tuple[str, str], str]
    cmake: str
    files: tuple[Path, ...]
    modules: dict[Path, ast.Module]
    ros_modules: dict[Path, ast.Module]
    unread: dict[Path, str]

    @property
    def is_python(self) -> bool:
        """Whether setuptools builds it."""
        return self.build_type == "ament_python"


def find_packages(path: Path) -> list[Path]:
    """Return the folder itself if it is a package, else the packages below it.

    Raises:
        UsageError: There is none.
    """
    if (path / "package.xml").is_file():
        return [path]
    found = [path / each.parent for each in _files(path) if each.name == "package.xml"]
    if not found:
        raise UsageError(f"there is no package.xml in {path} or below", "name a package's folder")
    return found


def read_package(folder: Path) -> Package:
    """Read a package.

    Raises:
        UnreadableFile: package.xml cannot be read.
    """
    try:
        root = ElementTree.fromstring(read_text(folder / "package.xml"))
    except (OSError, ElementTree.ParseError, ValueError) as error:
        raise UnreadableFile(f"{folder / 'package.xml'} cannot be read: {error}") from None
    files = tuple(_files(folder))
    modules: dict[Path, ast.Module] = {}
    ros_modules: dict[Path, ast.Module] = {}
    unread: dict[Path, str] = {}
    for path in files:
        if path.suffix == ".py" and path.parts[0] not in NEVER_INSTALLED:
            try:
                text = read_text(folder / path)
                modules[path] = ast.parse(text)
            except SyntaxError as error:
                unread[path] = f"line {error.lineno}: {error.msg}"
            except (OSError, ValueError, RecursionError, MemoryError) as error:
                unread[path] = str(error) or type(error).__name__
            else:
                if "rclpy" in text:
                    ros_modules[path] = modules[path]
    cmake = _optional(folder / "CMakeLists.txt")
    build_type = root.findtext("export/build_type") or ("ament_cmake" if cmake else "")
    return Package(
        folder=folder,
        name=(root.findtext("name") or "").strip(),
        build_type=build_type.strip(),
        depends=frozenset(
            (each.text or "").strip() for each in root if each.tag.endswith("depend")
        ),
        setup=_setup(modules.get(Path("setup.py"))),
        config=_config(_optional(folder / "setup.cfg")),
        cmake="\n".join(_COMMENT.sub("", line) for line in cmake.splitlines()),
        files=files,
        modules=modules,
        ros_modules=ros_modules,
        unread=unread,
    )


def read_text(path: Path) -> str:
    """Return the text of a regular file.

    Raises:
        OSError: It cannot be read, or is too large to be a source.
    """
    with open_regular(path) as stream:
        data = stream.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise OSError(f"{path} is larger than {MAX_BYTES / 1e6:.0f} MB")
    return data.decode(errors="replace")


def _optional(path: Path) -> str:
    try:
        return read_text(path)
    except OSError:
        return ""


def _files(folder: Path) -> Iterator[Path]:
    """Yield the files of a package, relative to it, without what tools made."""
    count = 0
    for top, folders, names in os.walk(folder):
        folders[:] = sorted(each for each in folders if each not in BUILT and each[0] != ".")
        for name in sorted(names):
            count += 1
            if count > MAX_FILES:
                return
            yield (Path(top) / name).relative_to(folder)


def _setup(tree: ast.Module | None) -> Setup | None:
    if tree is None:
        return None
    found = next((call for call in calls(tree) if called(call) == "setup"), None)
    return None if found is None else Setup(found, assigned_texts(tree))


def _config(text: str) -> dict[tuple[str, str], str]:
    parser = configparser.RawConfigParser(strict=False)
    try:
        parser.read_string(text)
    except configparser.Error:
        return {}
    return {
        (section, key): value
        for section in parser.sections()
        for key, value in parser.items(section)
    }
