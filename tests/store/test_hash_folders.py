"""A folder of copies is read as if their hashes were not in their names."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from robotctl.errors import UsageError
from robotctl.store import open_store
from robotctl.store.opened_bucket import opened_bucket
from robotctl.store.store_path import StorePath, path_of

SHA = "0123456789abcdef" * 4
KEY = f"run/{SHA}/run_0.mcap"


@pytest.fixture
def copies(tmp_path: Path) -> Iterator[Path]:
    store = open_store(str(tmp_path / "usb"))
    store.put_if_absent(KEY, [b"data"])
    store.put_if_absent(f"run/{SHA[::-1]}/clips/a.mcap", [b"clip"])
    yield tmp_path / "usb"
    opened_bucket.cache_clear()


@pytest.mark.parametrize("url", ["", "file://"])
def test_it_is_a_store_whose_paths_have_no_hashes(copies: Path, url: str) -> None:
    path = path_of(f"{url}{copies}")
    assert isinstance(path, StorePath)
    assert str(path) == str(copies)
    (run,) = path.iterdir()
    assert str(run) == f"{copies}/run"
    assert [str(each) for each in run.glob("*.mcap")] == [f"{copies}/run/run_0.mcap"]
    assert [str(each) for each in run.glob("clips/*")] == [f"{copies}/run/clips/a.mcap"]
    assert (run / "run_0.mcap").reader().read(1, 2) == b"at"
    assert isinstance(path_of(f"{copies}/run"), StorePath)


def test_what_needs_a_file_gets_the_copy_itself(copies: Path) -> None:
    assert os.fspath(path_of(str(copies)) / "run" / "run_0.mcap") == f"{copies}/{KEY}"


def test_a_file_that_was_changed_is_another_one_also_with_its_old_time(copies: Path) -> None:
    before = open_store(str(copies)).head(KEY)
    data, times = (copies / KEY).read_bytes(), (copies / KEY).stat()
    (copies / KEY).write_bytes(data[::-1])
    os.utime(copies / KEY, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert open_store(str(copies)).head(KEY).etag != before.etag


def test_a_file_beside_another_is_stored_where_that_is(copies: Path) -> None:
    path = path_of(str(copies)) / "run" / "run_0.mcap"
    assert isinstance(path, StorePath)
    beside = path.described().key.replace("run_0.mcap", "index.parquet")
    open_store(path.store_root).put(beside, [b"index"])
    assert (copies / "run" / SHA / "index.parquet").read_bytes() == b"index"


def test_a_file_of_another_computer_is_not_looked_for_here(copies: Path) -> None:
    assert str(path_of(f"file://localhost{copies}")) == str(copies)
    with pytest.raises(UsageError, match="file of the computer 'elsewhere'"):
        path_of(f"file://elsewhere{copies}")


def test_a_folder_of_recordings_stays_a_folder(tmp_path: Path) -> None:
    (tmp_path / "run" / "clips").mkdir(parents=True)
    (tmp_path / "run" / "run_0.mcap").touch()
    for path in (tmp_path, tmp_path / "run", tmp_path / "run" / "run_0.mcap", tmp_path / "gone"):
        assert type(path_of(str(path))) is type(Path())
