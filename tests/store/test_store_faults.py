"""A bucket that fails: what helps is tried again, the rest is named, and no secret is shown."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from robotctl.errors import UsageError
from robotctl.store import (
    AccessDenied,
    NoSuchObject,
    ObjectChanged,
    StoreError,
    StoreFailed,
    is_url,
    open_store,
)
from tests.support.faulty_bucket import FaultyBucket, Moved

ROBOTS = "s3://robots"


def test_failures_of_five_percent_and_short_answers_are_not_noticed(bucket: FaultyBucket) -> None:
    data = bytes(range(250))
    bucket["run.mcap"] = data
    bucket.failing_share = bucket.short_share = 0.05
    store = open_store(ROBOTS)
    found = store.head("run.mcap")
    for begin in range(60):
        assert store.get_range(found, begin, begin + 50) == data[begin : begin + 50]
    assert bucket.requests > 61


def test_a_store_that_only_fails_is_an_error_after_some_tries(
    bucket: FaultyBucket, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robotctl.store.bucket.MAX_RETRIES", 2)
    bucket["run.mcap"] = b"0123456789"
    store = open_store(ROBOTS)
    found = store.head("run.mcap")
    bucket.short_share = 1.0
    with pytest.raises(StoreFailed, match=r"s3://robots/run\.mcap: .* broke off"):
        store.get_range(found, 0, 5)
    assert bucket.requests == 1 + 2 * 3


def test_an_object_that_changes_between_two_ranges_is_told(bucket: FaultyBucket) -> None:
    bucket["run.mcap"] = b"0123456789"
    store = open_store(ROBOTS)
    found = store.head("run.mcap")
    assert store.get_range(found, 0, 5) == b"01234"
    bucket["run.mcap"] = b"0123456780"
    with pytest.raises(ObjectChanged):
        store.get_range(found, 5, 10)


def test_an_object_that_vanishes_is_named(bucket: FaultyBucket) -> None:
    bucket["run.mcap"] = b"0123456789"
    store = open_store(ROBOTS)
    found = store.head("run.mcap")
    bucket.objects.clear()
    with pytest.raises(NoSuchObject, match=r"s3://robots/run\.mcap does not exist"):
        store.get_range(found, 5, 10)


def test_a_claimed_size_takes_no_memory(
    bucket: FaultyBucket, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robotctl.store.bucket.MAX_RETRIES", 1)
    bucket["run.mcap"] = b"0123456789"
    bucket.lying_size = 10**15
    store = open_store(ROBOTS)
    found = store.head("run.mcap")
    assert found.size_bytes == 10**15
    with pytest.raises(StoreFailed):
        store.get_range(found, 10**14, 10**14 + 10)


def test_refused_access_is_told_with_its_cure_and_without_secrets(bucket: FaultyBucket) -> None:
    bucket.before = lambda served, method, key: 403
    with pytest.raises(AccessDenied) as denied:
        open_store(ROBOTS).put_if_absent("run.mcap", [b""])
    assert str(denied.value).startswith(
        "s3://robots/run.mcap: access is denied (SlowDown): set AWS_ACCESS"
    )
    assert "very-secret" not in repr(denied.value)


def test_a_bucket_of_another_region_is_told(bucket: FaultyBucket) -> None:
    bucket.before = lambda served, method, key: 301
    with pytest.raises(StoreFailed, match="sends requests elsewhere: set AWS_REGION"):
        open_store(ROBOTS).head("run.mcap")


def test_a_redirect_is_followed(bucket: FaultyBucket) -> None:
    bucket["run.mcap"] = b"0123456789"
    bucket["old.mcap"] = Moved("/robots/run.mcap")
    store = open_store(f"{bucket.endpoint}/robots")
    assert store.get_range(store.head("old.mcap"), 2, 5) == b"234"


def test_a_bucket_that_does_not_exist_is_named(
    monkeypatch: pytest.MonkeyPatch, s3_endpoint: str
) -> None:
    for name, value in {"AWS_ENDPOINT_URL": s3_endpoint, "AWS_ALLOW_HTTP": "true"}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("AWS_SKIP_SIGNATURE", "true")
    with pytest.raises(NoSuchObject, match="s3://nowhere: there is no such bucket"):
        list(open_store("s3://nowhere").list())


def test_a_connection_without_encryption_must_be_asked_for(
    bucket: FaultyBucket, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("AWS_ALLOW_HTTP")
    with pytest.raises(StoreFailed, match=r"would not be encrypted: .* AWS_ALLOW_HTTP=true"):
        open_store(ROBOTS).head("run.mcap")
    with pytest.raises(UsageError, match=r"would not be encrypted: .* AWS_ALLOW_HTTP=true"):
        open_store("http://robots.example/x")


def test_a_server_that_is_not_there_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AWS_ALLOW_HTTP", "true")
    monkeypatch.setattr("robotctl.store.bucket.MAX_RETRIES", 0)
    with pytest.raises(StoreFailed, match="refuses the connection: check the network"):
        open_store("http://127.0.0.1:9").head("run.mcap")


@pytest.mark.parametrize(
    "url",
    ["ftp://host/x", "s3://", "https://user:very-secret@host/x", "https://host/x?very-secret"],
)
def test_a_wrong_url_is_told_without_what_may_be_a_password(url: str) -> None:
    assert is_url(url)
    with pytest.raises(UsageError) as wrong:
        open_store(url)
    assert "very-secret" not in str(wrong.value)


def test_a_missing_library_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "obstore", None)
    with pytest.raises(UsageError, match=r"not installed: pip install 'robotctl\[store\]'"):
        open_store("s3://robots/x")


def test_a_link_below_a_folder_is_not_followed(tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "secret").write_bytes(b"1")
    folder = tmp_path / "store"
    folder.mkdir()
    (folder / "folder").symlink_to(outside)
    (folder / "file").symlink_to(outside / "secret")
    store = open_store(str(folder))
    assert list(store.list()) == []
    for key in ("file", "folder/secret"):
        with pytest.raises(StoreError):
            store.head(key)
    with pytest.raises(StoreError):
        store.put_if_absent("folder/new", [b""])
    assert [path.name for path in outside.iterdir()] == ["secret"]


def test_ctrl_c_ends_a_request_at_once_and_quietly(bucket: FaultyBucket) -> None:
    asked = []

    def hang(served: FaultyBucket, method: str, key: str) -> None:
        asked.append(key)
        time.sleep(3)

    bucket.before = hang
    program = "from robotctl.store import open_store; open_store('s3://robots').head('x')"
    with subprocess.Popen(
        [sys.executable, "-c", program], env=dict(os.environ), stderr=subprocess.PIPE
    ) as process:
        deadline = time.monotonic() + 30
        while not asked and time.monotonic() < deadline:
            time.sleep(0.01)
        interrupted = time.monotonic()
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=30)
    assert time.monotonic() - interrupted < 2
    assert errors.rstrip().endswith(b"KeyboardInterrupt")
    assert b"panicked" not in errors
