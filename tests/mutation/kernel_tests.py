"""Runs the tests of the kernel in a process that loads them for one mutant."""

from __future__ import annotations

import itertools
import multiprocessing
import os
import resource
import shutil
import signal
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, settings

TREE = Path(__file__).parents[2]
TESTS = Path("tests/kernel")

RUN_LAST = ("test_codec.py", "test_driving.py", "test_properties.py")
"""The slow test files; those that import the changed module run first, and kill most mutants."""

CPU_S, WALL_S, MEMORY_BYTES = 240, 3600, 4 << 30
"""Limits of one run of the tests, which takes 25 to 60 s of CPU: a mutant may never end."""

FIRST_FILES = 2
"""How many of the files that noticed the last mutants of a module run first."""

FAILED = "failed"
"""The file in the copy that names the file of tests that failed."""

LIMIT_CODE = 99
"""Exit code of a run that one of the limits ended."""

_stamps_s = itertools.count(1)
"""Times of change, a new one for each mutant: bytecode that a test has cached is told by it."""


def copied(folder: Path) -> Path:
    """Copy into `folder` what the tests of the kernel need."""
    for name in ("robotctl", "tests", "docs"):
        shutil.copytree(TREE / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(TREE / "pyproject.toml", folder)
    return folder


def prepare(folder: Path) -> None:
    """Let this process import from the copy in `folder`, and write what it prints there."""
    with (folder / "output").open("w") as output:
        os.dup2(output.fileno(), 1)
        os.dup2(output.fileno(), 2)
    os.chdir(folder)
    for variable in ("PYTHONPATH", "LD_LIBRARY_PATH", "AMENT_PREFIX_PATH"):
        os.environ.pop(variable, None)  # for a sourced ROS the tests would start this script again
    # An editable install finds its modules before sys.path does: those of the tree, not the copy.
    sys.meta_path[:] = [each for each in sys.meta_path if "editable" not in type(each).__module__]
    sys.path.insert(0, str(folder))
    settings.register_profile(
        "mutation",
        derandomize=True,
        database=None,
        deadline=None,
        phases=(Phase.explicit, Phase.generate),  # how a mutant fails need not be made simple
        suppress_health_check=[HealthCheck.too_slow],
    )


def options_of_pytest() -> list[str]:
    """Return the options of each run."""
    options = ["-x", "-q", "-n0", "-p", "no:cacheprovider", "--hypothesis-profile=mutation"]
    return [*options, "-W", "ignore::pytest.PytestAssertRewriteWarning"]  # it is imported above


@dataclass(frozen=True, slots=True)
class NewProcesses:
    """Runs the tests of the copy in `folder`, in a new process for each mutant."""

    folder: Path
    cpu_s: Mapping[str, float]
    """The CPU time of each test: the quick ones run first."""

    killers: dict[Path, list[Path]] = field(default_factory=dict)
    """The files of tests that noticed mutants of each module, the last one first."""

    def exit_code_with(self, path: Path, code: str) -> int:
        """Run the tests of the kernel with `code` at `path`; return their exit code."""
        original, status = path.read_text(), path.stat()
        path.write_text(code)
        stamp_s = next(_stamps_s)
        os.utime(path, (stamp_s, stamp_s))
        killers = self.killers.setdefault(path, [])
        failed = self.folder / FAILED
        failed.write_text("")
        try:
            return _run_tests(self.folder, path.stem, killers[:FIRST_FILES], self.cpu_s)
        finally:
            path.write_text(original)
            os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))
            if name := failed.read_text():
                file = self.folder / name
                killers[:] = [file, *(each for each in killers if each != file)]


def imports(file: Path, module: str) -> bool:
    """Return whether a file of tests imports a module of the kernel."""
    return f"kernel.{module} import" in _text_of(file)


@cache
def _text_of(file: Path) -> str:
    return file.read_text()


def _run_tests(
    folder: Path, changed: str, first: Sequence[Path], cpu_s: Mapping[str, float]
) -> int:
    """Run the tests in a process of their own: `first`, then those that import `changed`."""
    files = sorted((folder / TESTS).glob("test_*.py"), key=lambda file: file.name in RUN_LAST)
    files = [file for file in files if file not in first]
    near = [file for file in files if file.name not in RUN_LAST and imports(file, changed)]
    groups = [*([file] for file in first), near, [file for file in files if file not in near]]
    fork = multiprocessing.get_context("fork")
    process = fork.Process(target=_test, args=(folder, groups, cpu_s), daemon=True)
    process.start()
    process.join(WALL_S)
    process.kill()
    process.join()
    code = process.exitcode
    return LIMIT_CODE if code is None or code < 0 else code


def _test(folder: Path, groups: Iterable[Sequence[Path]], cpu_s: Mapping[str, float]) -> None:
    signal.signal(signal.SIGXCPU, _end_tests)
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_S, CPU_S + 10))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    prepare(folder)
    code = 0
    plugins = [_Order(cpu_s), _FirstFailure(folder)]
    for files in filter(None, groups):
        code = code or pytest.main([*options_of_pytest(), *map(str, files)], plugins)
    # isort: split
    import robotctl

    assert Path(robotctl.__file__ or "").is_relative_to(folder), robotctl.__file__
    os._exit(code)


@dataclass(frozen=True, slots=True)
class _Order:
    """A plugin of pytest that lets the quick tests run first."""

    cpu_s: Mapping[str, float]

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items.sort(key=lambda item: self.cpu_s.get(item.nodeid, 0.0))


@dataclass(frozen=True, slots=True)
class _FirstFailure:
    """A plugin of pytest that notes the file of the test that failed, or could not be loaded."""

    folder: Path

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self._note(report)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        self._note(report)

    def _note(self, report: pytest.TestReport | pytest.CollectReport) -> None:
        if report.failed:
            (self.folder / FAILED).write_text(report.nodeid.partition("::")[0])


def _end_tests(*_signal: object) -> None:
    pytest.exit("too much CPU time", LIMIT_CODE)
