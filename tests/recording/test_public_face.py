"""The names that a library user may import from `robotctl.recording`."""

from __future__ import annotations

import subprocess
import sys

import pytest

import robotctl.recording


def test_every_public_name_can_be_imported() -> None:
    for name in robotctl.recording.__all__:
        found = getattr(robotctl.recording, name)
        assert found.__module__.startswith("robotctl.recording."), name


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'Recoder'"):
        robotctl.recording.Recoder  # noqa: B018


def test_importing_the_package_imports_no_module_of_it() -> None:
    code = (
        "import sys, robotctl.recording;"
        "print([n for n in sys.modules if n.startswith(('robotctl.', 'mcap', 'zstandard'))])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "['robotctl.recording']"
