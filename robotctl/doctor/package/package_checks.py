"""All checks of the packages in a folder."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from robotctl.doctor.finding import Finding, fault, ok
from robotctl.doctor.package import behaviour, depending, installing, naming, workspace
from robotctl.doctor.package.package_files import Package, find_packages, read_package


def check_packages(path: Path, environment: Mapping[str, str]) -> Iterator[Finding]:
    """Judge the package in a folder, or each one below it, as seen from a shell.

    Raises:
        UsageError: There is no package.
        UnreadableFile: A package.xml cannot be read.
    """
    packages = [read_package(folder) for folder in find_packages(path)]
    names = [package.name for package in packages]
    faults = [*behaviour.check_qos(packages)]
    for package in packages:
        faults += _faults(package, names, environment)
    yield from faults
    if not faults:
        yield ok("packages", f"no classic mistake in {', '.join(sorted(set(names)))}")


def _faults(
    package: Package, names: list[str], environment: Mapping[str, str]
) -> Iterator[Finding]:
    for path, problem in package.unread.items():
        text = f"{package.name}/{path} cannot be read as Python: {problem}"
        yield fault("syntax", text, "correct it; the other checks leave this file out")
    yield from installing.check_entry_points(package)
    yield from installing.check_data_files(package)
    yield from installing.check_interfaces(package)
    yield from installing.check_executable_bit(package)
    yield from naming.check_dashes(package)
    yield from naming.check_collisions(package, names)
    yield from depending.check_depends(package)
    yield from depending.check_two_rclpys(package)
    yield from depending.check_pep_668(package)
    yield from behaviour.check_spin_in_callback(package)
    yield from workspace.check_sourced(package, environment)
