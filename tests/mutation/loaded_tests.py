"""Runs the tests of the kernel again and again without loading them again.

A process loads pytest, the kernel and all tests once, and notes which test runs which lines of the
kernel. For each mutant it forks, gives one function the changed code, and runs the tests that run
the changed statement until one fails: first those that noticed the last mutants of this function,
then the quick ones, those that import its module before the others.
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
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from types import CodeType, FrameType, FunctionType
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

QUICK_S = 0.5
"""CPU time of a quick test, with that of noting its lines."""

LEAST_CPU_S, TIMES_AS_LONG = 5.0, 4.0
"""A test may take this much CPU time, and so many times what it takes without a mutant."""


class Ran(NamedTuple):
    """A run of the tests with a mutant: pytest's exit code, and the test that failed."""

    code: int
    failed: str = ""


class Without(NamedTuple):
    """What a test does without a mutant: the lines that it runs in each file, and its CPU time.

    The CPU time includes that of noting the lines.
    """

    cpu_s: float
    lines: Mapping[str, frozenset[int]]

    def runs(self, mutant: Mutant) -> bool:
        """Return whether the test runs the statement that a mutant changes."""
        return not self.lines.get(str(mutant.path), frozenset()).isdisjoint(mutant.lines)


class LoadedTests:
    """The process that has loaded the tests."""

    def __init__(self, connection: Connection, cpu_s: Mapping[str, float]) -> None:
        """`cpu_s` is the CPU time of each test without a mutant."""
        self._connection = connection
        self.cpu_s = cpu_s

    def run(self, mutant: Mutant) -> Ran | None:
        """Run the tests with a mutant.

        None: it changes more than the code of one function, or what runs only while the kernel is
        loaded, so the kernel must be loaded with it.
        """
        self._connection.send(mutant)
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
        cpu_s = _received(ours)
        if not cpu_s:
            raise RuntimeError(
                f"the tests fail without a mutant:\n{(folder / 'output').read_text()}"
            )
        yield LoadedTests(ours, cpu_s)
    finally:
        ours.close()
        process.join(10)
        process.kill()


def _received(connection: Connection) -> dict[str, float]:
    try:
        cpu_s: dict[str, float] = connection.recv()
    except EOFError:
        return {}
    return cpu_s


def _serve(folder: Path, connection: Connection) -> None:
    prepare(folder)
    pytest.main([*options_of_pytest(), str(folder / TESTS)], plugins=[_Server(folder, connection)])


@dataclass(slots=True)
class _Server:
    """A plugin of pytest that runs the collected tests whenever it is asked to."""

    folder: Path
    connection: Connection
    without: dict[str, Without] = field(default_factory=dict)
    """What each test does without a mutant."""

    killers: dict[str, list[str]] = field(default_factory=dict)
    """The tests that noticed the last mutants of each function, the last one first."""

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Serve, in place of a run of the tests."""
        first, found = _in_a_copy(lambda: _watched(session, self.folder))
        for test, (cpu_s, lines) in found.items():
            ran = {file: frozenset(numbers) for file, numbers in lines.items()}
            self.without[test] = Without(cpu_s, ran)
        cpu_s = {test: each.cpu_s for test, each in self.without.items()}
        self.connection.send({} if first.code else cpu_s)
        while first.code == 0:
            try:
                mutant = self.connection.recv()
            except EOFError:
                break
            self.connection.send(self._mutated(session, mutant))
        return True

    def _mutated(self, session: pytest.Session, mutant: Mutant) -> Ran | None:
        where = mutant.where
        change = change_of(mutant.path.relative_to(self.folder), mutant.code, where)
        if change is None:
            return None
        running = [item for item in session.items if self.without[item.nodeid].runs(mutant)]
        if not running:
            return None
        items = self._in_order(running, mutant.path.stem, where)

        def run() -> tuple[Ran, Any]:
            change.make()
            return _run(session, items, self.without), None

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

        def rank(item: pytest.Item) -> tuple[int, bool, bool, float]:
            known = killers.index(item.nodeid) if item.nodeid in killers else len(killers)
            cpu_s = self.without[item.nodeid].cpu_s
            return known, cpu_s > QUICK_S, not imports(item.path, module), cpu_s

        return sorted(items, key=rank)


class Change(NamedTuple):
    """A function of a loaded module, and the code that a mutant gives it."""

    function: FunctionType
    code: CodeType

    def make(self) -> None:
        """Give the function the code, and forget what it returned without it."""
        function, code = self
        function.__code__ = code
        for cache in _caches():
            cache.cache_clear()


def change_of(path: Path, code: str, where: str) -> Change | None:
    """Return what a mutant changes of a loaded module.

    `where` is module.Class.function. None, if the change is not within one function, or within a
    function that another one makes: those that were made already would keep their code.
    """
    name = ".".join(path.with_suffix("").parts)
    module = sys.modules.get(name)
    if module is None:
        return None
    names = where.split(".")[len(path.relative_to(KERNEL).with_suffix("").parts) :]
    found: Any = module
    compiled: CodeType | None = compile(code, module.__file__ or "", "exec", dont_inherit=True)
    for number, each in enumerate(names, 1):
        found = vars(found).get(each) if hasattr(found, "__dict__") else None
        compiled = _inner(compiled, each)
        function = _function_of(found)
        if function is not None and compiled is not None:
            before = function.__code__
            makes_another = number < len(names)
            is_same = _runs(before) == _runs(compiled)
            if makes_another or is_same or before.co_freevars != compiled.co_freevars:
                return None
            return Change(function, compiled)
    return None


def _inner(code: CodeType | None, name: str) -> CodeType | None:
    """Return the only code called `name` that stands in other code."""
    consts = () if code is None else code.co_consts
    found = [each for each in consts if isinstance(each, CodeType) and each.co_name == name]
    return found[0] if len(found) == 1 else None


def _runs(code: CodeType) -> tuple[object, ...]:
    """Return what is run of some code, wherever its lines stand: a decorator is not part of it."""
    consts = [
        _runs(each) if isinstance(each, CodeType) else (type(each), each) for each in code.co_consts
    ]
    return code.co_code, code.co_names, code.co_varnames, repr(consts)


def _function_of(found: object) -> FunctionType | None:
    """Return the function behind a method, a property or a cache."""
    if isinstance(found, (classmethod, staticmethod)):
        found = found.__func__
    elif isinstance(found, property):
        found = found.fget
    found = getattr(found, "__wrapped__", found)
    return found if isinstance(found, FunctionType) else None


def _caches() -> list[functools._lru_cache_wrapper[Any]]:
    found = gc.get_objects()
    return [each for each in found if isinstance(each, functools._lru_cache_wrapper)]


def _watched(
    session: pytest.Session, folder: Path
) -> tuple[Ran, dict[str, tuple[float, dict[str, list[int]]]]]:
    """Run all tests without a mutant, and return what each one does."""
    lines: defaultdict[str, set[int]] = defaultdict(set)
    caches = _caches()
    kernel = str(folder / KERNEL)

    def note_call(frame: FrameType, _event: str, _arg: object) -> Callable[..., Any] | None:
        if not frame.f_code.co_filename.startswith(kernel):
            return None
        note = lines[frame.f_code.co_filename].add

        def note_line(frame: FrameType, _event: str, _arg: object) -> Callable[..., Any]:
            note(frame.f_lineno)
            return note_line

        return note_line(frame, _event, _arg)

    found: dict[str, tuple[float, dict[str, list[int]]]] = {}
    for item, following in _followed(session.items):
        lines.clear()
        for cache in caches:
            cache.cache_clear()  # a test that uses what another one cached depends on it, too
        begun_s = _cpu_s()
        sys.settrace(note_call)
        try:
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
        finally:
            sys.settrace(None)
        ran = {file: sorted(each) for file, each in lines.items()}
        found[item.nodeid] = (_cpu_s() - begun_s, ran)
        if session.testsfailed:
            return Ran(1, item.nodeid), found
    return Ran(0), found


def _followed(items: Sequence[pytest.Item]) -> Iterator[tuple[pytest.Item, pytest.Item | None]]:
    """Yield each test with the one that follows."""
    return zip(items, [*items[1:], None], strict=True)


def _in_a_copy(run: Callable[[], tuple[Ran, Any]]) -> tuple[Ran, Any]:
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
    ran, found = json.loads(text)
    return Ran(*ran), found


def _run(
    session: pytest.Session, items: Sequence[pytest.Item], without: Mapping[str, Without]
) -> Ran:
    """Run tests up to the first that fails."""
    signal.signal(signal.SIGPROF, lambda *_: os._exit(LIMIT_CODE))
    for item, following in _followed(items):
        allowed_s = LEAST_CPU_S + TIMES_AS_LONG * without[item.nodeid].cpu_s
        signal.setitimer(signal.ITIMER_PROF, allowed_s)
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
        if session.testsfailed:
            return Ran(1, item.nodeid)
    return Ran(0)


def _cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime
