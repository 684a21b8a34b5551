"""What is read from a store, which anyone with its credentials may have written."""

from __future__ import annotations

import pytest

from robotctl.collect.manifest import CollectedFile, Manifest
from robotctl.collect.object_names import ObjectName, collected_recordings
from robotctl.errors import UnreadableFile
from robotctl.store import StoredObject

SHA = "0" * 64


def test_the_name_of_an_object_is_read_as_it_was_written() -> None:
    name = ObjectName("robot_20260101_120000", SHA, "clips/a.mcap")
    assert name.key == f"robot_20260101_120000/{SHA}/clips/a.mcap"
    assert ObjectName.parse(name.key) == name


@pytest.mark.parametrize(
    "key",
    [
        "",
        "robot",
        f"robot/{SHA}",
        f"robot/{SHA}/",
        f"robot/{SHA[1:]}/a",
        f"robot/{SHA.replace('0', 'G')}/a",
        f"../{SHA}/a",
        f"robot/{SHA}/../a",
        f"robot/{SHA}//a",
        f"robot/{SHA}/.hidden",
        f"robot/{SHA}/a\nb",
        f"robot/{SHA}/a\x1b[31m",
        f"robot/{SHA}/ä",
    ],
)
def test_other_names_are_no_part_of_a_recording(key: str) -> None:
    assert ObjectName.parse(key) is None
    assert collected_recordings([StoredObject(key, 1, "")]) == {}


def test_the_newest_manifest_counts() -> None:
    keys = [f"r/{x * 64}/manifest-{n:06}.json" for x, n in (("a", 2), ("b", 10), ("c", 9))]
    recording = collected_recordings(StoredObject(key, 1, "") for key in keys)["r"]
    assert recording.manifest == ObjectName.parse(keys[1])


def test_the_same_files_give_the_same_manifest() -> None:
    manifest = Manifest("r", (CollectedFile("a.mcap", 3, SHA, 17),))
    assert Manifest.from_bytes(manifest.to_bytes()) == manifest
    later = manifest.to_bytes().replace(b'"name"', b'"of a later version":1,"name"')
    assert Manifest.from_bytes(later) == manifest


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"{}",
        b"[" * 100_000,
        b'{"recording":"r","files":[{"name":"../a","size_bytes":1,"sha256":"%s","modified_ns":1}]}'
        % SHA.encode(),
        b'{"recording":"r","files":[{"name":"a","size_bytes":-1,"sha256":"%s","modified_ns":1}]}'
        % SHA.encode(),
        b'{"recording":"r","files":[{"name":"a","size_bytes":1,"sha256":"%s","modified_ns":1e9}]}'
        % SHA[1:].encode(),
    ],
)
def test_what_is_no_manifest_is_refused(text: bytes) -> None:
    with pytest.raises(UnreadableFile, match="not a manifest"):
        Manifest.from_bytes(text)
