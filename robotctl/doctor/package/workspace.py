"""The workspace around a package: built, and sourced in this shell."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path

from robotctl.doctor.finding import Finding, fault
from robotctl.doctor.package.package_files import Package


def check_sourced(package: Package, environment: Mapping[str, str]) -> Iterator[Finding]:
    """A package that was built is known to this shell."""
    workspace = next(
        (each.parent for each in package.folder.resolve().parents if each.name == "src"), None
    )
    if workspace is None or not (workspace / "install" / "local_setup.bash").is_file():
        return  # it was not built yet
    install = workspace / "install"
    prefixes = {
        Path(each).resolve()
        for each in environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
        if each
    }
    if not {install, install / package.name} & prefixes:
        yield fault(
            "not sourced",
            f"this shell does not know {package.name}: its workspace was built, but not sourced",
            f". {install}/setup.bash, in each new shell",
        )
