"""What a library user may rely on: the public faces, and the examples of docs/library.md."""

from __future__ import annotations

import ast
import inspect
import re
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, get_args

import pytest

from robotctl.kernel import Effect, Event
from robotctl.testing.drives import drive, record
from tests.support.cases import for_each
from tests.support.lines import Ran, run_program

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "library.md").read_text()

FACES = ["robotctl.ros.executor", "robotctl.kernel", "robotctl.recording", "robotctl.rerun"]
ABSENT = {  # what loading every name of a face must not import
    "robotctl.kernel": {"asyncio", "logging", "msgspec", "mcap", "rclpy", "rich", "typer"},
    "robotctl.recording": {"asyncio", "rclpy", "rich", "typer"},
    "robotctl.rerun": {"rclpy", "rich", "typer"},
}

EXAMPLES = {
    face: "".join(re.findall(r"^```python\n(.*?)^```", section, re.MULTILINE | re.DOTALL))
    for face, section in re.findall(
        r"^## (robotctl[\w.]+)\n(.*?)(?=^## |\Z)", PAGE, re.MULTILINE | re.DOTALL
    )
}
"""The programs of each section, as one."""


PUBLIC = [(face, name) for face in FACES for name in import_module(face).__all__]


def source_of(face: str, name: str) -> ModuleType:
    """Return the module that defines a name of a face."""
    tree = ast.parse(Path(import_module(face).__file__ or "").read_text())
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and name in [alias.name for alias in node.names]:
            return import_module(node.module or "")
    raise AssertionError(f"{face} does not import {name}")


def assigned_doc(module: ModuleType, name: str) -> str:
    """Return the text below the assignment of a constant or type alias, "" without one."""
    body = ast.parse(inspect.getsource(module)).body
    for node, after in zip(body, [*body[1:], ast.Pass()], strict=True):
        if (
            isinstance(node, ast.Assign | ast.AnnAssign)
            and name in ast.unparse(node).split(" = ")[0]
        ):
            is_text = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
            return ast.unparse(after) if is_text else ""
    raise AssertionError(f"{module.__name__} does not assign {name}")


def functions_of(value: Any) -> Iterator[Any]:
    """Yield a function, or the public methods and properties of a class."""
    if inspect.isfunction(value):
        yield value
    elif inspect.isclass(value):
        for name, member in vars(value).items():
            plain = getattr(member, "fget", None) or getattr(member, "__func__", member)
            if inspect.isfunction(plain) and (not name.startswith("_") or name == "__init__"):
                yield plain


@for_each("face", FACES)
def test_a_face_names_all_that_it_offers_and_no_more(face: str) -> None:
    module = import_module(face)
    tree = ast.parse(Path(module.__file__ or "").read_text())
    (typed,) = [
        node
        for node in tree.body
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
    ]
    imported = [
        alias.asname or alias.name
        for node in typed.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    ]
    assert sorted(imported) == sorted(module.__all__)
    for name in module.__all__:
        assert getattr(module, name) is getattr(source_of(face, name), name)
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = module.nothing


def test_every_event_and_effect_is_public() -> None:
    values = {kind.__name__ for kind in (*get_args(Event), *get_args(Effect))}
    assert values <= set(import_module("robotctl.kernel").__all__)


@for_each(("face", "name"), PUBLIC)
def test_each_public_name_is_documented(face: str, name: str) -> None:
    value = getattr(import_module(face), name)
    if not (inspect.isclass(value) or inspect.isfunction(value)):
        assert assigned_doc(source_of(face, name), name), name
        return
    # A dataclass without a docstring gets its signature for one.
    assert value.__doc__, name
    assert not value.__doc__.startswith(f"{name}("), name
    for function in functions_of(value):
        generated = function.__qualname__.startswith("__create_fn__") or function.__name__ in (
            "__init__",
            "__replace__",
        )
        assert generated or function.__doc__, f"{name}.{function.__name__}"


@for_each(("face", "name"), PUBLIC)
def test_no_signature_of_a_face_names_what_is_private(face: str, name: str) -> None:
    for function in functions_of(getattr(import_module(face), name)):
        for parameter, kind in inspect.get_annotations(function).items():
            private = re.findall(r"\b_[a-zA-Z]\w*", str(kind))
            assert not private, f"{name}.{function.__name__}: {parameter}"
            assert not re.match(r"_[a-z]", parameter), f"{name}.{function.__name__}: {parameter}"


@for_each("face", ABSENT)
def test_a_face_loads_no_more_than_it_needs(face: str) -> None:
    program = (
        f"import sys, {face} as face\n"
        "for name in face.__all__: getattr(face, name)\n"
        "print(*{name.split('.')[0] for name in sys.modules})"
    )
    assert not loaded_by(program) & ABSENT[face]


def test_importing_a_face_loads_nothing_heavy() -> None:
    loaded = loaded_by(f"import sys, {', '.join(FACES)}\nprint(*sys.modules)")
    assert not loaded & {"asyncio", "rclpy", "msgspec", "mcap", "zstandard", "numpy"}


def loaded_by(program: str) -> set[str]:
    command = [sys.executable, "-P", "-c", program]
    return set(run_program(*command).succeeded().split())


def test_the_page_has_an_example_of_each_face() -> None:
    assert list(EXAMPLES) == FACES
    assert all(EXAMPLES.values())


@pytest.mark.parametrize("face", FACES)
def test_the_example_runs(face: str, tmp_path: Path, domain_id: int) -> None:
    record(tmp_path / "recordings" / "run", drive(seconds=2.0))
    command = [sys.executable, "-P", "-c", EXAMPLES[face]]
    assert run_program(*command, cwd=tmp_path) == Ran(0, "", "")
