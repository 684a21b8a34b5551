"""In a shell that has sourced another ROS, ours is imported."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from robotctl.base.environment import prepare, without_foreign_ros
from tests.support.cases import for_each
from tests.support.lines import Ran, run_program

REPOSITORY = Path(__file__).parents[1]
SOURCED = ("PYTHONPATH", "LD_LIBRARY_PATH", "AMENT_PREFIX_PATH")

PROGRAM = """
import os, sys
from robotctl.base.environment import prepare
print(prepare())
import rclpy
print(rclpy.__file__)
print(rclpy.get_rmw_implementation_identifier())
from ament_index_python import get_package_prefix
print(get_package_prefix("rclpy"))
print(sorted(name for name in os.environ if "NOTE" in name), *sys.argv[1:])
"""


def foreign_ros(folder: Path) -> Path:
    """Create a ROS installation in the layout of another distribution; nothing in it works."""
    packages = folder / "lib" / "python3.10" / "site-packages"
    for package in ("rclpy", "std_msgs", "rosidl_generator_py"):
        (packages / package).mkdir(parents=True)
        (packages / package / "__init__.py").write_text("raise ImportError('the foreign one')\n")
    for name in ("librcl.so", "librmw_implementation.so"):
        (folder / "lib" / name).write_bytes(b"no library")
    (folder / "share" / "rclpy").mkdir(parents=True)
    index = folder / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True)
    (index / "rclpy").touch()
    return folder


def overlay(folder: Path) -> Path:
    """Create a workspace with a message package."""
    (folder / "lib" / "python3" / "site-packages" / "my_msgs").mkdir(parents=True)
    (folder / "share" / "my_msgs").mkdir(parents=True)
    return folder


def shell() -> dict[str, str]:
    """Return the environment of a shell without a sourced ROS."""
    known = {"ROS_DISTRO", "RMW_IMPLEMENTATION", "_ROS_WHEELS_BOOTSTRAP_COMPLETE", *SOURCED}
    return {name: value for name, value in os.environ.items() if name not in known}


def sourced(ros: Path, distro: str, *overlays: Path) -> dict[str, str]:
    """Return the environment of a shell after sourcing setup.bash."""
    environment = shell()
    packages = [over / "lib" / "python3" / "site-packages" for over in overlays]
    packages += [ros / "lib" / "python3.10" / "site-packages", REPOSITORY]
    libraries = [*(over / "lib" for over in overlays), ros / "opt" / "vendor" / "lib", ros / "lib"]
    for variable, entries in zip(SOURCED, (packages, libraries, [*overlays, ros]), strict=True):
        environment[variable] = os.pathsep.join(map(str, entries))
    return environment | {"ROS_DISTRO": distro}


def run(environment: dict[str, str], *command: str) -> Ran:
    return run_program(sys.executable, *command, env=environment, cwd=REPOSITORY)


@pytest.mark.parametrize("distro", ["humble", "jazzy"])
def test_a_process_in_a_shell_with_another_ros_imports_ours_and_says_so(
    distro: str, tmp_path: Path
) -> None:
    environment = sourced(foreign_ros(tmp_path), distro)
    environment["RMW_IMPLEMENTATION"] = "rmw_cyclonedds_cpp"
    told = run(environment, "-c", PROGRAM, "an argument").succeeded()
    note, module, rmw, prefix, rest = told.splitlines()
    assert note == (
        f"dropped another ROS ({distro}) from PYTHONPATH, LD_LIBRARY_PATH, AMENT_PREFIX_PATH; "
        "replaced rmw_cyclonedds_cpp by rmw_fastrtps_cpp, the only middleware that robotctl brings"
    )
    assert Path(module).is_relative_to(sys.prefix)
    assert rmw == "rmw_fastrtps_cpp"
    assert prefix == sys.prefix
    assert rest == "[] an argument"


@pytest.mark.parametrize("variable", SOURCED)
def test_a_foreign_rclpy_on_one_variable_alone_is_found(variable: str, tmp_path: Path) -> None:
    everything = sourced(foreign_ros(tmp_path), "")
    environment = {
        name: value for name, value in everything.items() if name not in {*SOURCED} - {variable}
    }
    environment.setdefault("PYTHONPATH", str(REPOSITORY))
    note, module, *_ = run(environment, "-c", PROGRAM).succeeded().splitlines()
    assert note == f"dropped another ROS from {variable}"
    assert Path(module).is_relative_to(sys.prefix)


def test_without_another_ros_nothing_is_dropped_and_nothing_said() -> None:
    environment = shell() | {"PYTHONPATH": str(REPOSITORY), "ROS_DISTRO": "jazzy"}
    assert run(environment, "-c", PROGRAM).succeeded().splitlines()[0] == ""


def test_the_rclpy_of_this_run_is_our_own() -> None:
    import rclpy

    assert Path(rclpy.__file__).is_relative_to(sys.prefix)


def test_pytest_in_a_shell_with_another_ros_uses_ours_and_says_so(tmp_path: Path) -> None:
    environment = sourced(foreign_ros(tmp_path), "humble")
    this = f"{__file__}::{test_the_rclpy_of_this_run_is_our_own.__name__}"
    options = ("-n0", "-p", "no:cacheprovider")
    run(environment, "-m", "pytest", *options, "tests/ros/conftest.py", this).succeeded(
        "1 passed",
        "robotctl: dropped another ROS (humble) from PYTHONPATH, LD_LIBRARY_PATH, "
        "AMENT_PREFIX_PATH\n",
    )


def test_overlays_of_our_distribution_stay_and_those_of_others_go(tmp_path: Path) -> None:
    ros, workspace = foreign_ros(tmp_path / "ros"), overlay(tmp_path / "workspace")
    prefix = tmp_path / "ours"
    cleaned, _ = without_foreign_ros(sourced(ros, "jazzy", workspace), prefix)
    assert cleaned["AMENT_PREFIX_PATH"] == str(workspace)
    assert cleaned["LD_LIBRARY_PATH"] == str(workspace / "lib")
    packages = workspace / "lib" / "python3" / "site-packages"
    assert cleaned["PYTHONPATH"] == f"{packages}{os.pathsep}{REPOSITORY}"
    cleaned, _ = without_foreign_ros(sourced(ros, "humble", workspace), prefix)
    assert cleaned["PYTHONPATH"] == str(REPOSITORY)
    assert {"AMENT_PREFIX_PATH", "LD_LIBRARY_PATH", "ROS_DISTRO"}.isdisjoint(cleaned)


def test_what_lies_in_our_own_environment_is_never_foreign(tmp_path: Path) -> None:
    ours = foreign_ros(tmp_path / "ours")
    link = tmp_path / "link"
    link.symlink_to(ours)
    environment = sourced(link, "humble")
    assert without_foreign_ros(environment, ours) == (environment, "")


@pytest.mark.parametrize(
    ("given", "found"),
    [
        ({}, {"RANGE": "LOCALHOST"}),
        ({"RANGE": "SUBNET"}, {"RANGE": "SUBNET"}),
        ({"ONLY": "0"}, {"RANGE": "LOCALHOST"}),
        ({"ONLY": "0", "RANGE": "SUBNET", "PEERS": "a"}, {"RANGE": "SUBNET", "PEERS": "a"}),
        ({"ONLY": "1", "RANGE": "SUBNET", "PEERS": "a"}, {"RANGE": "LOCALHOST"}),
    ],
)
def test_discovery_ends_at_this_machine_unless_the_user_chose_otherwise(
    given: dict[str, str], found: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    names = {
        "RANGE": "ROS_AUTOMATIC_DISCOVERY_RANGE",
        "PEERS": "ROS_STATIC_PEERS",
        "ONLY": "ROS_LOCALHOST_ONLY",
    }
    for key, name in names.items():
        monkeypatch.setenv(name, given.get(key, ""))
        if key not in given:
            monkeypatch.delenv(name)
    prepare()
    assert {key: os.environ[name] for key, name in names.items() if name in os.environ} == found


@for_each("variable", ["", "FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"])
def test_fast_dds_announces_more_often_unless_the_user_configured_it(variable: str) -> None:
    known = {"FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"}
    environment = {name: value for name, value in os.environ.items() if name not in known}
    if variable:
        environment[variable] = "/mine.xml"
    program = (
        "import os; from robotctl.base.environment import prepare; prepare();"
        "print(os.environ.get('FASTRTPS_DEFAULT_PROFILES_FILE'))"
    )
    told = run_program(sys.executable, "-c", program, env=environment).succeeded().strip()
    if variable:
        assert told == environment.get("FASTRTPS_DEFAULT_PROFILES_FILE", "None")
    else:
        assert "<leaseAnnouncement>" in Path(told).read_text()
