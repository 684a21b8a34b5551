"""Runs the tests of the kernel again and again without loading them again.

A process loads pytest, the kernel and all tests once. For each mutant it forks, gives one function
of the kernel the changed code, and runs the tests until one fails: first those that noticed the
last mutants of this function, then those that import its module, the quick ones first.
"""

from __future__ import annotations

import functools
import gc
import json
import multiprocessing
import os
import resource
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any, NamedTuple

import pytest

from tests.mutation.kernel_tests import (
    LIMIT_CODE,
    MEMORY_BYTES,
    TESTS,
    imports,
    options_of_pytest,
    prepare,
)
from tests.mutation.mutants import KERNEL, Mutant

FIRST_KILLERS = 8
"""How many of the tests that noticed the last mutants of a function run first."""

LEAST_CPU_S, TIMES_AS_LONG = 5.0, 20.0
"""A test may take this much CPU time, and so many times what it takes without a mutant."""


class Ran(NamedTuple):
    """A run of the tests with a mutant: pytest's exit code, and the test that failed."""

    code: int
    failed: str = ""


class LoadedTests:
    """The process that has loaded the tests."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def run(self, mutant: Mutant) -> Ran | None:
        """Run the tests with a mutant.

        None: it changes more than the code of one function, so the kernel must be loaded with it.
        """
        self._connection.send((mutant.path, mutant.code, mutant.where))
        found: Ran | None = self._connection.recv()
        return found


@contextmanager
def loaded_tests(folder: Path) -> Iterator[LoadedTests]:
    """Load the tests of the copy in `folder`, in a process that ends with the block.

    Raises:
        RuntimeError: They fail without a mutant.
    """
    fork = multiprocessing.get_context("fork")
    ours, theirs = fork.Pipe()
    process = fork.Process(target=_serve, args=(folder, theirs), daemon=True)
    process.start()
    theirs.close()
    try:
        if not _received(ours):
            raise RuntimeError(
                f"the tests fail without a mutant:\n{(folder / 'output').read_text()}"
            )
        yield LoadedTests(ours)
    finally:
        ours.close()
        process.join(10)
        process.kill()


def _received(connection: Connection) -> bool:
    try:
        return bool(connection.recv())
    except EOFError:
        return False


def _serve(folder: Path, connection: Connection) -> None:
    prepare(folder)
    pytest.main([*options_of_pytest(), str(folder / TESTS)], plugins=[_Server(folder, connection)])


@dataclass(slots=True)
class _Server:
    """A plugin of pytest that runs the collected tests whenever it is asked to."""

    folder: Path
    connection: Connection
    cpu_s: dict[str, float] = field(default_factory=dict)
    """The CPU time of each test without a mutant."""

    killers: dict[str, list[str]] = field(default_factory=dict)
    """The tests that noticed the last mutants of each function, the last one first."""

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Serve, in place of a run of the tests."""
        first, times = _in_a_copy(lambda: _run(session, session.items, {}))
        self.cpu_s = times
        self.connection.send(first.code == 0)
        while first.code == 0:
            try:
                path, code, where = self.connection.recv()
            except EOFError:
                break
            self.connection.send(self._mutated(session, path, code, where))
        return True

    def _mutated(self, session: pytest.Session, path: Path, code: str, where: str) -> Ran | None:
        change = change_of(path.relative_to(self.folder), code, where)
        if change is None:
            return None
        items = self._in_order(session.items, path.stem, where)

        def run() -> tuple[Ran, dict[str, float]]:
            change()
            return _run(session, items, self.cpu_s)

        ran, _ = _in_a_copy(run)
        if ran.failed:
            killers = self.killers.setdefault(where, [])
            if ran.failed in killers:
                killers.remove(ran.failed)
            killers.insert(0, ran.failed)
            del killers[FIRST_KILLERS:]
        return ran

    def _in_order(self, items: Sequence[pytest.Item], module: str, where: str) -> list[pytest.Item]:
        killers = self.killers.get(where, [])

        def rank(item: pytest.Item) -> tuple[int, bool, float]:
            known = killers.index(item.nodeid) if item.nodeid in killers else len(killers)
            is_far = not imports(item.path, module)
            return known, is_far, self.cpu_s.get(item.nodeid, 0.0)

        return sorted(items, key=rank)


def change_of(path: Path, code: str, where: str) -> Callable[[], None] | None:
    """Return what gives one function of a loaded module the code that it has in `code`.

    `where` is module.Class.function. None, if the change is not within one function.
    """
    name = ".".join(path.with_suffix("").parts)
    module = sys.modules.get(name)
    if module is None:
        return None
    names = where.split(".")[len(path.relative_to(KERNEL).with_suffix("").parts) :]
    found: Any = module
    compiled: CodeType | None = compile(code, module.__file__ or "", "exec", dont_inherit=True)
    for each in names:
        found = vars(found).get(each) if hasattr(found, "__dict__") else None
        compiled = _inner(compiled, each)
        function = _function_of(found)
        if function is not None and compiled is not None:
            if (
                function.__code__ == compiled
                or function.__code__.co_freevars != compiled.co_freevars
            ):
                return None
            return functools.partial(_replace, function, compiled)
    return None


def _inner(code: CodeType | None, name: str) -> CodeType | None:
    """Return the only code called `name` that stands in other code."""
    consts = () if code is None else code.co_consts
    found = [each for each in consts if isinstance(each, CodeType) and each.co_name == name]
    return found[0] if len(found) == 1 else None


def _function_of(found: object) -> FunctionType | None:
    """Return the function behind a method, a property or a cache."""
    if isinstance(found, (classmethod, staticmethod)):
        found = found.__func__
    elif isinstance(found, property):
        found = found.fget
    found = getattr(found, "__wrapped__", found)
    return found if isinstance(found, FunctionType) else None


def _replace(function: FunctionType, code: CodeType) -> None:
    function.__code__ = code
    for each in gc.get_objects():
        if isinstance(each, functools._lru_cache_wrapper):
            each.cache_clear()


def _in_a_copy(run: Callable[[], tuple[Ran, dict[str, float]]]) -> tuple[Ran, dict[str, float]]:
    """Run in a copy of this process; a copy that ends otherwise has met a limit."""
    reading, writing = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            os.close(reading)
            resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
            answer = json.dumps(run()).encode()
            while answer:
                answer = answer[os.write(writing, answer) :]
        finally:
            os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as stream:
        text = stream.read()
    os.waitpid(pid, 0)
    if not text:
        return Ran(LIMIT_CODE), {}
    ran, times = json.loads(text)
    return Ran(*ran), times


def _run(
    session: pytest.Session, items: Sequence[pytest.Item], known_cpu_s: dict[str, float]
) -> tuple[Ran, dict[str, float]]:
    """Run tests up to the first that fails; return the CPU time of each."""
    times: dict[str, float] = {}
    signal.signal(signal.SIGPROF, lambda *_: os._exit(LIMIT_CODE))
    for item, following in zip(items, [*items[1:], None], strict=True):
        begun = _cpu_s()
        if known_cpu_s:
            allowed_s = LEAST_CPU_S + TIMES_AS_LONG * known_cpu_s.get(item.nodeid, 0.0)
            signal.setitimer(signal.ITIMER_PROF, allowed_s)
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
        times[item.nodeid] = _cpu_s() - begun
        if session.testsfailed:
            return Ran(1, item.nodeid), times
    return Ran(0), times


def _cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime
