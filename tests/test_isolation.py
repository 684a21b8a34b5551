"""What a test file leaves behind in its process is named, with what it was before."""

from __future__ import annotations

import functools
import logging
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, chdir
from pathlib import Path
from types import ModuleType

import pytest

from tests.support.isolation import FileSurroundings
from tests.support.waiting import until


def variable(stack: ExitStack, folder: Path) -> None:
    stack.enter_context(pytest.MonkeyPatch.context()).setenv("LEFT_BEHIND", "1")


def working_folder(stack: ExitStack, folder: Path) -> None:
    stack.enter_context(chdir(folder))


def thread(stack: ExitStack, folder: Path) -> None:
    end = threading.Event()
    threading.Thread(target=end.wait, name="left-behind").start()
    stack.callback(end.set)


def child(stack: ExitStack, folder: Path) -> None:
    process = stack.enter_context(subprocess.Popen(["sleep", "60"]))
    stack.callback(process.kill)
    until((Path("/proc") / str(process.pid) / "cmdline").read_bytes)  # empty during its start


def descriptor(stack: ExitStack, folder: Path) -> None:
    stack.enter_context((folder / "file").open("w"))


def handler(stack: ExitStack, folder: Path) -> None:
    logger, added = logging.getLogger("robotctl.left_behind"), logging.NullHandler()
    logger.addHandler(added)
    stack.callback(logger.removeHandler, added)


def cache(stack: ExitStack, folder: Path) -> None:
    module = ModuleType("robotctl.left_behind")
    module.square = functools.cache(square)  # type: ignore[attr-defined]
    sys.modules[module.__name__] = module
    stack.callback(sys.modules.pop, module.__name__)
    module.square(3)
    stack.callback(module.square.cache_clear)


def square(number: int) -> int:
    return number**2


square.__module__ = "robotctl.left_behind"


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


@pytest.mark.parametrize(
    ("leave", "named"),
    [
        (variable, "environ LEFT_BEHIND: not there -> 1"),
        (working_folder, "folder: "),
        (thread, "left-behind"),
        (child, "sleep 60"),
        (descriptor, "/file"),
        (cache, "cache robotctl.left_behind.square: not there -> 1 entries"),
        (handler, "handlers robotctl.left_behind: not there -> [<NullHandler"),
    ],
)
def test_what_a_file_leaves_behind_is_named(
    leave: Callable[[ExitStack, Path], None], named: str, stack: ExitStack, tmp_path: Path
) -> None:
    file = FileSurroundings()
    file.begin()
    leave(stack, tmp_path)
    (line,) = [line for line in file.left_over(settling_s=0.0) if named in line]
    stack.close()
    assert line not in file.left_over()
