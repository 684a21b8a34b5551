"""Tests meet no ROS but our own, nobody else's robot, and no file of the user's."""

from __future__ import annotations

import gc
import os
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from robotctl.base.domains import reserved_domain
from robotctl.base.environment import prepare
from tests.support.isolation import FileSurroundings, start_once
from tests.support.stores import s3_server

# The same examples in each run, and no limits on how long one takes: they depend on the machine.
settings.register_profile(
    "suite", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("suite")

# What the tests start would compile all of robotctl again each time.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

gc.disable()  # imports make no garbage

_notes: list[str] = []
_file_surroundings = FileSurroundings()


def pytest_plugin_registered(plugin: object, plugin_name: str) -> None:
    """Leave a foreign ROS behind before any other conftest imports from it.

    The restart would lose what is captured, and with it all further output.
    """
    if plugin_name == "capturemanager":
        stop = plugin.stop_global_capturing  # type: ignore[attr-defined]
        _notes.append(prepare(before_restart=stop))


def pytest_configure(config: pytest.Config) -> None:
    """Hear of the fixtures of the whole run, which the hooks of this file do not."""
    config.pluginmanager.register(_file_surroundings)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mix the folders, so that some files compute while others wait; the longest are not last."""
    folders = Counter(path.parent for path in {item.path for item in items})
    seen, place = Counter[Path](), dict[Path, float]()
    for item in items:
        folder = item.path.parent
        if item.path not in place:
            share = 0.9 if folder.name in ("daemon", "replay") else 1.0
            place[item.path] = share * (seen[folder] + 0.5) / folders[folder]
            seen[folder] += 1
    items.sort(key=lambda item: place[item.path])


def pytest_collection_finish() -> None:
    """Leave what was imported out of each later search for garbage."""
    gc.freeze()
    gc.enable()


def pytest_report_header() -> list[str]:
    """Say what was left out."""
    return [f"robotctl: {note}" for note in _notes if note]


@pytest.fixture(scope="session", autouse=True)
def interruptible() -> None:
    """What a test starts can be interrupted, also under nohup and in the background."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


@pytest.fixture(scope="session")
def s3_endpoint() -> Iterator[str]:
    """An S3 server with the empty bucket `robots`."""
    with s3_server() as endpoint:
        yield endpoint


@pytest.fixture(scope="session", autouse=True)
def isolated_session() -> Iterator[None]:
    """Discovery on this machine only; sockets, logs and latches in a folder of this run.

    The folder's path is short, for the path of a socket may have 107 bytes.
    """
    with (
        tempfile.TemporaryDirectory(prefix="rt-", dir="/tmp", ignore_cleanup_errors=True) as folder,
        pytest.MonkeyPatch.context() as patch,
    ):
        for variable, name in (("XDG_RUNTIME_DIR", "run"), ("XDG_STATE_HOME", "state")):
            (Path(folder) / name).mkdir(mode=0o700)
            patch.setenv(variable, str(Path(folder) / name))
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        patch.delenv("ROS_DOMAIN_ID", raising=False)
        patch.delenv("ROBOTCTL_ROBOT", raising=False)
        for name in ("fsync", "fdatasync"):  # no file of a test need outlive a power cut
            patch.setattr(os, name, lambda descriptor: None)
        start_once()
        yield


@pytest.fixture(scope="module", autouse=True)
def isolated_file(isolated_session: None) -> Iterator[None]:
    """A file leaves the process as it found it, so that files may run in any order."""
    _file_surroundings.begin()
    yield
    if found := _file_surroundings.left_over():
        pytest.fail("the file leaves behind:\n" + "\n".join(found), pytrace=False)


@pytest.fixture
def domain_id(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A ROS domain that no process on this machine uses, also for what the test starts."""
    with reserved_domain() as number:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(number))
        yield number
