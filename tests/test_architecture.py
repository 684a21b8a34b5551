"""Who may import whom, read from the source: the arrows of docs/architecture.md.

docs/architecture.md shows the mode table and the exit codes as the code has them.
"""

from __future__ import annotations

import ast
import re
import runpy
import sys
from collections import Counter
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import robotctl
from robotctl.base import errors
from tests.support.cases import for_each
from tests.support.lines import run_program

ROOT = Path(robotctl.__file__).parent

PAGE = ROOT.parent / "docs" / "architecture.md"

ROS_MODULES = {"rclpy", "ament_index_python", "rosidl_runtime_py", "robot_controller"}
MESSAGE_SUFFIXES = ("_msgs", "_interfaces", "_srvs")
PROTOCOL_MAY = {
    "base.errors",
    "base.paths",
    "base.trust",
    "ipc.answers",
    "ipc.method_names",
    "ipc.protocol",
}


def modules(package: str) -> list[Path]:
    return sorted((ROOT / package).rglob("*.py"))


@cache
def imports(path: Path) -> tuple[str, ...]:
    """Return the full name of every module that the file imports, also within functions."""
    found: list[str] = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import"
            assert node.module is not None
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                found.append(inner if source_of(inner) else node.module)
    return tuple(found)


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


@cache
def rows() -> tuple[tuple[set[str], set[str]], ...]:
    """Return the table of the page: in each row the rooms, and what they may import of others."""
    layout = PAGE.read_text(encoding="utf-8").split("## Layout", 1)[1].split("\n## ", 1)[0]
    cells = re.findall(r"^\| (`[a-z_.`, ]+`) \| [^|]+ \|([^|]*)\|$", layout, re.MULTILINE)
    name = re.compile(r"`([a-z_.]+)`")
    return tuple((set(name.findall(rooms)), set(name.findall(may))) for rooms, may in cells)


@cache
def rooms() -> dict[str, set[str]]:
    """Return each room of the page, and what it may import of the others."""
    return {room: allowed for named, allowed in rows() for room in named}


def is_within(module: str, room: str) -> bool:
    return module == room or module.startswith(f"{room}.")


@cache
def room_of(module: str) -> str:
    """Return the narrowest room of the page that holds the module."""
    return max((room for room in rooms() if is_within(module, room)), key=len, default="")


@cache
def own_modules() -> dict[str, Path]:
    """Return every module below robotctl, named without that."""
    paths = {".".join(path.relative_to(ROOT).with_suffix("").parts): path for path in modules("")}
    return {name.removesuffix(".__init__"): path for name, path in paths.items()}


def test_the_page_has_a_room_for_every_module_and_no_other() -> None:
    found = {name: room_of(name) for name in own_modules() if name != "__init__"}
    inner = {room.rpartition(".")[0] for room in rooms()}
    assert {name for name, room in found.items() if not room and name not in inner} == set()
    assert set(rooms()) == {room for room in found.values() if room}


def test_imports_keep_to_the_table_of_the_page() -> None:
    table = rooms()
    for name, path in own_modules().items():
        if not (room := room_of(name)):
            continue
        within = {room, *(other for other in table if is_within(other, room))}
        for used in own_imports(path) - {"__init__"}:
            allowed = any(is_within(used, other) for other in {*table[room], *within})
            assert allowed, f"{name} ({room}) imports {used}"


def test_the_table_allows_no_more_than_is_used() -> None:
    used: dict[str, set[str]] = {room: set() for room in rooms()}
    for name, path in own_modules().items():
        if room := room_of(name):
            used[room] |= own_imports(path)
    for named, allowed in rows():
        of_row = set[str]().union(*(used[room] for room in named))
        idle = {each for each in allowed if not any(is_within(one, each) for one in of_row)}
        assert not idle, f"{named} does not import {idle}"


def test_no_imports_go_in_a_circle() -> None:
    graph = {name: own_imports(path) - {name} for name, path in own_modules().items()}
    TopologicalSorter(graph).prepare()  # raises CycleError, with the circle


LONGEST_LINES = 700


def test_no_file_has_more_lines_than_one_concept_needs() -> None:
    for name, path in own_modules().items():
        assert len(path.read_bytes().splitlines()) <= LONGEST_LINES, name


MOST_MODULES = 25


def test_no_folder_has_more_modules_than_one_sees_at_once() -> None:
    files = {"__init__", "__main__"}
    names = [name for name, path in own_modules().items() if path.stem not in files]
    for folder, count in Counter(name.rpartition(".")[0] for name in names).items():
        assert count <= MOST_MODULES, f"{folder} has {count} modules"


CEILINGS = {"robotctl": (319, 66_102), "tests": (218, 55_000)}
"""How many files and lines there may be."""


@for_each("folder", CEILINGS)
def test_the_house_does_not_grow_beyond_its_ceilings(folder: str) -> None:
    """What grows here makes room first: the ceilings are lowered, never raised."""
    paths = sorted((ROOT.parent / folder).rglob("*.py"))
    files, lines = CEILINGS[folder]
    assert len(paths) <= files
    assert sum(len(path.read_bytes().splitlines()) for path in paths) <= lines


def test_a_name_of_a_class_is_unique_in_its_package() -> None:
    homes: dict[tuple[str, str], set[str]] = {}
    for name, path in own_modules().items():
        package = name if path.stem == "__init__" else name.rpartition(".")[0]
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef):
                homes.setdefault((package, node.name), set()).add(name)
    assert {key: sorted(found) for key, found in homes.items() if len(found) > 1} == {}


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


def test_the_kernel_opens_nothing_prints_nothing_and_computes_alike_on_each_processor() -> None:
    exact = {"inf", "nan", "pi", "tau", "sqrt", "fsum", "copysign", "isfinite", "isnan"}
    for path in (*modules("kernel"), *modules("sim")):
        nodes = [*ast.walk(ast.parse(path.read_text(encoding="utf-8")))]
        names = {node.id for node in nodes if isinstance(node, ast.Name)}
        assert not names & {"open", "print", "input", "hash", "id", "set", "globals"}, path.name
        taken = [each for each in nodes if isinstance(each, ast.ImportFrom)]
        used = {name.name for each in taken if each.module == "math" for name in each.names}
        assert used <= exact, path.name


def test_no_simple_queue_is_waited_for_with_a_timeout() -> None:
    """Before Python 3.13 the wait of a thread that runs late may have no end."""
    for path in own_modules().values():
        text = path.read_text()
        assert "SimpleQueue" not in text or not re.search(r"\.get\([^()]*timeout", text), path


def test_only_the_ros_package_imports_ros() -> None:
    for name, path in own_modules().items():
        assert is_within(name, "ros") or not any(map(is_ros, foreign_imports(path))), name


@for_each("module", ["ipc.protocol", "ipc.answers", "ipc.method_names", "ipc.client"])
def test_the_client_needs_only_the_standard_library(module: str) -> None:
    path = ROOT.joinpath(*module.split(".")).with_suffix(".py")
    assert foreign_imports(path) <= set(sys.stdlib_module_names)
    assert own_imports(path) <= PROTOCOL_MAY


def test_importing_the_kernel_brings_no_loop_and_no_ros() -> None:
    program = (
        "import sys, robotctl.kernel.kernel, robotctl.kernel.codec, robotctl.kernel.codec\n"
        "print(*sorted({name.split('.')[0] for name in sys.modules}))"
    )
    ran = run_program(sys.executable, "-S", "-c", program, cwd=ROOT.parent)
    loaded = set(ran.succeeded().split())
    assert "robotctl" in loaded
    assert not loaded & {"asyncio", "rclpy", "msgspec", "rich", "yaml", "logging"}


def test_the_mode_diagram_is_drawn_from_the_table() -> None:
    drawn = runpy.run_path(str(ROOT.parent / "docs" / "mode_diagram.py"))["mermaid"]()
    assert drawn.startswith("stateDiagram-v2\n")
    shown = PAGE.read_text(encoding="utf-8")
    assert f"```mermaid\n{drawn}\n```\n" in shown, "paste: python docs/mode_diagram.py"


def test_the_page_names_every_exit_code() -> None:
    codes = {
        kind.exit_code
        for kind in vars(errors).values()
        if isinstance(kind, type) and issubclass(kind, errors.RobotctlError)
    }
    text = PAGE.read_text(encoding="utf-8").split("## Exit codes", 1)[1]
    named = {int(number) for number in re.findall(r"\b(\d+) [a-z]", text)}
    assert named == codes | {0, errors.INTERRUPTED_EXIT_CODE}


def thread_names(path: Path) -> Iterator[str]:
    """Yield the name of each thread that the file creates."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and ast.unparse(node.func) in ("Thread", "threading.Thread"):
            names = [each.value for each in node.keywords if each.arg == "name"]
            assert names, f"{path}: a thread without a name"
            yield str(ast.literal_eval(names[0]))


def test_the_page_lists_every_thread_that_a_daemon_creates() -> None:
    section = PAGE.read_text(encoding="utf-8").split("## Threads and processes", 1)[1]
    page = section.split("\n## ", 1)[0]
    files = [path for part in ("daemon", "ros", "recording/write") for path in modules(part)]
    names = {name for path in files for name in thread_names(path)}
    assert {"watchdog", "latch", "recorder"} <= names
    assert {name for name in names if f"`{name}`" not in page} == set()
