"""What every store promises: a bucket of a real S3 server, and a folder."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from robotctl.store import NoSuchObject, ObjectChanged, ObjectStore, Stamp, StoreError
from tests.support.memory_store import content


def test_what_was_stored_is_listed_and_read_back(store: ObjectStore) -> None:
    assert store.put_if_absent("day 1/run.mcap", [b"0123456789"])
    assert store.put_if_absent("day 1/metadata.yaml", [b""])
    assert store.put_if_absent("day 10/run.mcap", [b"abc"])
    listed = {found.key: found for found in store.list()}
    assert set(listed) == {"day 1/run.mcap", "day 1/metadata.yaml", "day 10/run.mcap"}
    assert {found.key for found in store.list("day 1")} == set(listed) - {"day 10/run.mcap"}
    found = store.head("day 1/run.mcap")
    assert found == listed["day 1/run.mcap"]
    assert found.size_bytes == 10
    assert store.get_range(found, 2, 5) == b"234"
    assert store.get_range(found, 3, 3) == b""
    assert content(store, "day 1/run.mcap") == b"0123456789"


def test_a_name_is_given_only_once(store: ObjectStore) -> None:
    assert store.put_if_absent("result", [b"first"])
    assert not store.put_if_absent("result", [b"second"])
    assert content(store, "result") == b"first"


def test_a_range_past_the_end_is_an_error_and_not_a_short_answer(store: ObjectStore) -> None:
    store.put_if_absent("run.mcap", [b"0123456789"])
    found = store.head("run.mcap")
    with pytest.raises(StoreError):
        store.get_range(found, 5, 11)
    with pytest.raises(StoreError):
        store.get_range(found, 10, 11)


def test_an_object_that_was_replaced_is_not_read_any_further(store: ObjectStore) -> None:
    store.put("run.mcap", [b"0123456789"])
    found = store.head("run.mcap")
    store.put("run.mcap", [b"abcdefghij"])
    with pytest.raises(ObjectChanged, match="changed while it was read"):
        store.get_range(found, 0, 5)


def test_an_object_that_is_not_there_is_named(store: ObjectStore) -> None:
    store.put_if_absent("a/run.mcap", [b"0123456789"])
    with pytest.raises(NoSuchObject, match=r"a/other\.mcap does not exist"):
        store.head("a/other.mcap")


def test_hash_and_time_are_kept_with_an_object(store: ObjectStore) -> None:
    store.put("small", [b"x"], Stamp("a hash", 1_700_000_000_123_456_789))
    assert store.put_if_absent("large", [bytes(9_000_000)], Stamp("b", 1_600_000_000_000_000_000))
    assert not store.put_if_absent("large", [bytes(9_000_000)])
    assert store.head("small").modified_ns == 1_700_000_000_123_456_789
    assert store.head("large").modified_ns == 1_600_000_000_000_000_000
    if "s3://" in store.name:  # a folder has no place for hashes
        assert (store.head("small").sha256, store.head("large").sha256) == ("a hash", "b")


def test_a_large_object_is_stored_from_parts_of_any_length(store: ObjectStore) -> None:
    parts = [bytes([number]) * 3_000_000 for number in range(4)]
    store.put("large", parts)
    assert content(store, "large") == b"".join(parts)


def test_nothing_is_stored_if_the_parts_end_with_an_error(store: ObjectStore) -> None:
    def parts() -> Iterator[bytes]:
        yield bytes(9_000_000)
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        store.put("large", parts())
    assert list(store.list()) == []


@pytest.mark.parametrize("key", ["", "/etc/passwd", "../run", "a/../b", "a//b", "a\n", "a" * 2000])
def test_a_name_that_leads_elsewhere_is_no_name(store: ObjectStore, key: str) -> None:
    with pytest.raises(StoreError, match="no object can have the name"):
        store.put_if_absent(key, [b""])
    with pytest.raises(StoreError, match="no object can have the name"):
        store.head(key)
