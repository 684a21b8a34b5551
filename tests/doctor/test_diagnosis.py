"""`robotctl doctor` tells every finding, also where no daemon can be asked."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from robotctl.base.errors import UsageError
from robotctl.base.paths import runtime_folder
from robotctl.cli.commands import doctor as diagnosis
from robotctl.doctor import Finding, Level


@pytest.fixture(autouse=True)
def asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[int | None]:
    """The domains of which ROS was asked, which is not started here."""
    domains: list[int | None] = []

    def ros(robot: str, config: object, domain_id: int | None) -> list[Finding]:
        domains.append(domain_id)
        return []

    monkeypatch.setattr(diagnosis, "_ros", ros)
    for variable, name in (("XDG_RUNTIME_DIR", "run"), ("XDG_STATE_HOME", "state")):
        monkeypatch.setenv(variable, str(tmp_path / name))
    (tmp_path / "run").mkdir(mode=0o700)
    monkeypatch.setenv("ROS_DOMAIN_ID", "77")
    monkeypatch.chdir(tmp_path)
    return domains


def faults(*, clean: bool = False) -> list[Finding]:
    _, found = diagnosis.diagnose("robot", None, None, clean=clean)
    assert {"wheels", "disk", "clock"} <= {each.check for each in found}
    return [each for each in found if each.level is Level.FAULT]


def open_to_all(folder: Path) -> None:
    folder.chmod(0o777)


def file_instead(folder: Path) -> None:
    folder.rmdir()
    folder.touch()


@pytest.mark.parametrize("clean", [False, True])
@pytest.mark.parametrize("spoil", [open_to_all, file_instead])
def test_an_unsafe_folder_of_sockets_is_one_finding_among_all(
    spoil: Callable[[Path], None], clean: bool, asked: list[int | None]
) -> None:
    spoil(runtime_folder().parent)
    (found,) = faults(clean=clean)
    assert found.check == "permissions"
    assert str(runtime_folder().parent) in found.text
    assert asked == [77], "that of the shell, for no daemon can be asked"


def test_a_socket_path_that_is_too_long_is_one_finding_among_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, asked: list[int | None]
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / ("x" * 120)))
    (found,) = faults()
    assert "longer than 107 bytes" in found.text
    assert found.cure == "set XDG_RUNTIME_DIR to a shorter folder"
    assert asked == [77]


def test_a_file_that_is_no_socket_of_a_robot_is_no_daemon_that_hangs() -> None:
    runtime_folder().mkdir(mode=0o700)
    for name in ("bad name.sock", ".sock", "esc\x1b[31m.sock"):
        (runtime_folder() / name).touch()
    assert faults() == []


def test_the_name_of_no_robot_is_refused() -> None:
    with pytest.raises(UsageError, match="use a letter"):
        diagnosis.diagnose("a b", None, None, clean=False)
