"""A recording names the software that made it; unknown versions never fail a start."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from robotctl.daemon.recording.provenance import provenance, revision, revision_around


def git(folder: Path, *arguments: str) -> str:
    identity = ["-c", "user.name=n", "-c", "user.email=e@example.org"]
    ran = subprocess.run(
        ["git", *identity, *arguments], cwd=folder, capture_output=True, text=True, check=True
    )
    return ran.stdout.strip()


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    folder = tmp_path / "repository"
    folder.mkdir()
    try:
        git(folder, "init", "-q")
    except FileNotFoundError:
        pytest.skip("git is not installed")
    git(folder, "commit", "-q", "--allow-empty", "-m", "first")
    return folder


def test_a_revision_is_what_git_says(repository: Path) -> None:
    first = git(repository, "rev-parse", "HEAD")
    assert revision(repository) == first
    git(repository, "commit", "-q", "--allow-empty", "-m", "second")
    git(repository, "pack-refs", "--all")
    second = git(repository, "rev-parse", "HEAD")
    assert revision(repository) == second != first
    git(repository, "checkout", "-q", "--detach", first)
    assert revision(repository) == first
    git(repository, "worktree", "add", "-q", "-b", "other", "../worktree", second)
    assert revision(repository.parent / "worktree") == second


def test_a_folder_within_a_repository_belongs_to_it(repository: Path) -> None:
    inner = repository / "src" / "deep"
    inner.mkdir(parents=True)
    assert revision(inner) == ""
    assert revision_around(inner) == git(repository, "rev-parse", "HEAD")


@pytest.mark.parametrize("head", [None, b"", b"\xff\xfe", b"ref: refs/heads/none\n", b"main"])
def test_what_is_no_repository_has_no_revision(tmp_path: Path, head: bytes | None) -> None:
    if head is not None:
        (tmp_path / ".git").mkdir()
        (tmp_path / ".git" / "HEAD").write_bytes(head)
    assert revision(tmp_path) == ""
    (tmp_path / "file").write_text("")
    assert revision(tmp_path / "file") == ""


def test_versions_and_host_are_named(repository: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(repository)
    known = provenance()
    names = {"robotctl", "python", "ros_distro", "rmw", "rclpy", "mcap", "host", "directory"}
    assert names <= set(known)
    assert known["directory"] == str(repository)
    assert known["git.directory"] == git(repository, "rev-parse", "HEAD")
    assert all(known.values())


def test_a_directory_that_is_gone_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert "directory" not in provenance()
