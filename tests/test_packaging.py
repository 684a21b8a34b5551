"""What is installed and released is what the code needs, and what pyproject.toml says."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from importlib.metadata import PackageNotFoundError, packages_distributions, requires
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).parents[1]
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

BUILT_HERE = "robot_controller"
"""The interfaces of msg/, srv/ and action/."""


EXTRAS: list[str] = [
    requirement
    for name, requirements in PROJECT["optional-dependencies"].items()
    if name not in ("test", "dev")
    for requirement in requirements
]
"""What commands need that not every user wants."""


def name_of(requirement: str) -> str:
    """Return the normalized name of the distribution that a requirement asks for."""
    name = re.match(r"[A-Za-z0-9._-]+", requirement)
    assert name is not None, requirement
    return re.sub(r"[-_.]+", "-", name[0]).lower()


def brought_by(distribution: str) -> set[str]:
    """Return the distribution and all that it requires, directly or not."""
    found: set[str] = set()
    waiting = [distribution]
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            try:
                waiting += [name_of(requirement) for requirement in requires(name) or ()]
            except PackageNotFoundError:  # an extra that is not installed
                continue
    return found


def imported_modules() -> dict[str, Path]:
    """Return each top-level module that robotctl imports, with one file that does."""
    found: dict[str, Path] = {}
    for path in sorted((ROOT / "robotctl").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module:
                names = [node.module]
            else:
                continue
            found |= {name.split(".")[0]: path for name in names}
    return found


def test_every_import_is_declared_or_comes_with_the_ros_wheels() -> None:
    declared = {name_of(requirement) for requirement in [*PROJECT["dependencies"], *EXTRAS]}
    for name in [name for name in declared if name.startswith("ros-")]:
        declared |= {each for each in brought_by(name) if each.startswith("ros-")}
    provided = packages_distributions()
    for module, path in imported_modules().items():
        if module in sys.stdlib_module_names or module in ("robotctl", BUILT_HERE):
            continue
        providers = {name_of(name) for name in provided.get(module, ())}
        assert providers & declared, f"{path.relative_to(ROOT)} imports {module}: {providers}"


def test_every_dependency_is_imported() -> None:
    provided = packages_distributions()
    used = {name_of(name) for module in imported_modules() for name in provided.get(module, ())}
    declared = {name_of(requirement) for requirement in [*PROJECT["dependencies"], *EXTRAS]}
    assert {name for name in declared - used if not name.startswith("ros-")} == set()


def test_the_hosted_workflow_runs_every_python_that_is_promised() -> None:
    promised = re.findall(r"Python :: (3\.\d+)", "\n".join(PROJECT["classifiers"]))
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text())
    job = workflow["jobs"]["run"]
    assert job["strategy"]["matrix"]["python"] == promised
    assert ".ci/run" in [step.get("run") for step in job["steps"]]
    lowest, above = re.findall(r"3\.(\d+)", PROJECT["requires-python"])
    assert promised == [f"3.{minor}" for minor in range(int(lowest), int(above))]
