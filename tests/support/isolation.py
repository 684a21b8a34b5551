"""The state of the process that a test file must restore, as the next file runs in it, too."""

from __future__ import annotations

import functools
import gc
import logging
import os
import re
import sys
import threading
import time
from collections.abc import Collection, Generator, Iterator, Mapping
from contextlib import suppress
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any, Final

import pytest
from obstore import list_with_delimiter_async
from obstore.store import MemoryStore

from robotctl.base.store.bucket import requests

Surroundings = Mapping[str, str]
"""A snapshot of that state: its kind and name to its value, as `environ HOME` -> `/root`."""

SETTLING_S: Final = 3.0
"""How long a thread, child or descriptor of a file's last test may need to end."""

PURE: Final[Collection[str]] = {
    *("_aligned", "_eventfd_write", "_hash_of", "_installed_hash", "_kinds", "_libc"),
    *("_qos_lines", "_rays", "_reader", "_setter", "_take_serialized", "_type_support"),
    *("_wrong_in", "corners_of", "counts_each_message", "declarations", "decoder_of"),
    *("free_beside_m", "function", "installed_type", "kernel_leaves", "library", "message_class"),
    *("path_of", "serialized_type", "software", "software_hash"),
}
"""Caches that no test can spoil: the values depend only on arguments, code and packages."""

ALLOWED: Final[Mapping[str, str]] = {
    r"environ PYTEST_CURRENT_TEST": "pytest sets it",
    r"cache .*\._provenance:": "what made a recording, once for each folder of a start",
    r"descriptor \d+: .* -> /tmp/#\d+ \(deleted\)": "objects that the S3 server keeps",
    r"descriptor \d+: .* -> .*/\.ros/log/": "rcl opens its log at the first message",
    r"descriptor \d+: .*socket:": "connections that the library of the stores keeps for a while",
    r"thread .*\(process_request_thread\)": "the other end of those connections",
    r"(thread|child|descriptor|cache) .* -> gone": "it belonged to what a fixture of the run did",
}
"""Regular expressions of differences that do not count, with the reason."""

_caches: dict[int, tuple[str, Any]] = {}
_scanned: set[str] = set()


def surroundings() -> dict[str, str]:
    """Return the present surroundings of this process."""
    found = {f"environ {name}": value for name, value in os.environ.items()}
    found["folder"] = os.getcwd()
    found |= {f"thread {each.native_id}": each.name for each in threading.enumerate()}
    found |= {f"child {pid}": name for pid, name in _children()}
    found |= {f"descriptor {number}": target for number, target in _descriptors()}
    found |= {f"handlers {name}": repr(each) for name, each in _handlers() if each}
    sizes = {f"cache {name}": cache.cache_info().currsize for name, cache in _found_caches()}
    found |= {name: f"{size} entries" for name, size in sizes.items() if size}
    return found


def differences(before: Surroundings, after: Surroundings) -> list[str]:
    """Return a line for each difference that counts."""
    lines = [
        f"{name}: {before.get(name, 'not there')} -> {after.get(name, 'gone')}"
        for name in sorted({*before, *after})
        if before.get(name) != after.get(name)
    ]
    return [line for line in lines if not any(re.match(each, line) for each in ALLOWED)]


def start_once() -> None:
    """Start threads and sockets that libraries start once and keep, before the first file."""

    async def ask() -> None:
        await list_with_delimiter_async(MemoryStore())  # starts the threads of the library

    requests().run(ask())
    resource_tracker.ensure_running()
    if "rclpy" in sys.modules:
        import rclpy
        from rclpy.context import Context

        import tests.support.rosidl_parser  # noqa: F401

        context = Context()
        rclpy.init(context=context)
        rclpy.create_node("first", context=context).destroy_node()  # the middleware keeps 3 sockets
        context.shutdown()


class FileSurroundings:
    """The surroundings before a test file, compared with those after it."""

    def __init__(self) -> None:
        self._before: Surroundings = {}

    def begin(self) -> None:
        """Store a snapshot of the surroundings before a file."""
        self._before = surroundings()

    def left_over(self, settling_s: float = SETTLING_S) -> list[str]:
        """Return the differences that do not pass by themselves."""
        end = time.monotonic() + settling_s
        while found := differences(self._before, surroundings()):
            if time.monotonic() > end:
                break
            gc.collect()
            time.sleep(0.05)
        return found

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(
        self, fixturedef: pytest.FixtureDef[object]
    ) -> Generator[None, object, object]:
        """Add what a session fixture starts to the snapshot of the file that uses it first."""
        if fixturedef.scope != "session":
            return (yield)
        before = surroundings()
        result = yield
        after = surroundings()
        gone = before.keys() - after.keys()
        new = {name: value for name, value in after.items() if before.get(name) != value}
        kept = {name: value for name, value in self._before.items() if name not in gone}
        self._before = kept | new
        return result


def _children() -> Iterator[tuple[str, str]]:
    own = str(os.getpid())
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it ended after it was listed
            state, parent, *_ = (folder / "stat").read_text().rpartition(")")[2].split()
            if parent == own and state != "Z":  # Python waits for those when it starts the next
                yield folder.name, (folder / "cmdline").read_text().replace("\0", " ")


def _descriptors() -> Iterator[tuple[str, str]]:
    for number in os.listdir("/proc/self/fd"):
        with suppress(OSError):  # the folder itself, which is closed again
            yield number, os.readlink(f"/proc/self/fd/{number}")


def _handlers() -> Iterator[tuple[str, list[logging.Handler]]]:
    yield "of the root", logging.getLogger().handlers
    for name, logger in list(logging.root.manager.loggerDict.items()):
        if name.partition(".")[0] == "robotctl" and isinstance(logger, logging.Logger):
            yield name, logger.handlers


def _found_caches() -> Iterator[tuple[str, Any]]:
    for name, module in list(sys.modules.items()):
        if name.partition(".")[0] == "robotctl" and name not in _scanned:
            _scanned.add(name)
            for owner in (module, *(each for each in vars(module).values() if _is_of(each, name))):
                for attribute, value in vars(owner).items():
                    if _is_own_cache(value) and attribute not in PURE:
                        _caches.setdefault(id(value), (f"{name}.{attribute}", value))
    return iter(list(_caches.values()))


def _is_of(value: object, module: str) -> bool:
    return isinstance(value, type) and value.__module__ == module


def _is_own_cache(value: object) -> bool:
    return isinstance(value, functools._lru_cache_wrapper) and value.__module__.startswith(
        "robotctl."
    )
