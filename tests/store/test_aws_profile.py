"""The keys of ~/.aws are used as by the AWS command line, unless the environment has others."""

from __future__ import annotations

from pathlib import Path

import pytest

from robotctl.store import open_store
from robotctl.store.bucket import profile_keys
from tests.support.faulty_bucket import FaultyBucket


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    (tmp_path / "credentials").write_text(
        "[default]\naws_access_key_id = ONE\naws_secret_access_key = 50%off\n"
        "[robots]\naws_access_key_id = TWO\naws_secret_access_key = s\naws_session_token = t\n"
    )
    (tmp_path / "config").write_text("[default]\nregion = eu-west-1\n[profile robots]\nx = y\n")
    return {
        "AWS_SHARED_CREDENTIALS_FILE": str(tmp_path / "credentials"),
        "AWS_CONFIG_FILE": str(tmp_path / "config"),
    }


def test_a_profile_gives_keys_and_region(environment: dict[str, str]) -> None:
    assert profile_keys(environment) == {
        "access_key_id": "ONE",
        "secret_access_key": "50%off",
        "region": "eu-west-1",
    }
    assert profile_keys(environment | {"AWS_PROFILE": "robots"}) == {
        "access_key_id": "TWO",
        "secret_access_key": "s",
        "session_token": "t",
    }


def test_the_environment_counts_more(environment: dict[str, str]) -> None:
    assert profile_keys(environment | {"AWS_ACCESS_KEY_ID": "x"}) == {}
    assert profile_keys(environment | {"AWS_SKIP_SIGNATURE": "true"}) == {}
    assert "region" not in profile_keys(environment | {"AWS_REGION": "us-east-1"})


@pytest.mark.parametrize("text", ["", "no section", "[default]\nregion = x\n", "\0\udc80"])
def test_a_file_without_keys_gives_none(environment: dict[str, str], text: str) -> None:
    Path(environment["AWS_SHARED_CREDENTIALS_FILE"]).write_bytes(text.encode(errors="replace"))
    assert profile_keys(environment) == {}
    assert profile_keys(environment | {"AWS_PROFILE": "absent"}) == {}


def test_requests_are_signed_with_the_keys_of_a_profile(
    bucket: FaultyBucket, environment: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.delenv(name)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    bucket["run.mcap"] = b"0"
    open_store("s3://robots").head("run.mcap")
    (authorization,) = bucket.authorizations
    assert "Credential=ONE/" in authorization
