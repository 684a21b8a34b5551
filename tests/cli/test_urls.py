"""Recordings in a store: the offline commands say what they say of the same files here."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cli.conftest import Cli
from tests.support.stores import FaultyBucket, serving

STOPPED = Path(__file__).parents[1] / "golden" / "stopped"
(FILE,) = STOPPED.glob("*.mcap")
URL = f"s3://robots/day/stopped/{FILE.name}"


@pytest.fixture
def bucket(monkeypatch: pytest.MonkeyPatch) -> Iterator[FaultyBucket]:
    """A bucket that holds a recording with an emergency stop."""
    with serving(monkeypatch) as bucket:
        for path in STOPPED.iterdir():
            bucket[f"day/stopped/{path.name}"] = path.read_bytes()
        yield bucket


@pytest.mark.parametrize(
    "command",
    [
        *("info PATH", "info PATH --json", "replay --check PATH --all-bytes", "verify PATH"),
        "export PATH --topic /odom --json",
    ],
)
def test_a_command_says_of_a_url_what_it_says_of_the_file(
    cli: Cli, bucket: FaultyBucket, command: str
) -> None:
    here = cli(*command.replace("PATH", str(FILE)).split())
    there = cli(*command.replace("PATH", URL).split())
    assert here.out
    assert there.out == here.out.replace(str(FILE), URL)
    assert there.exit_code == here.exit_code
    assert there.err == here.err.replace(str(FILE), URL)


@pytest.mark.parametrize(
    "command",
    [
        *("recover URL", "replay URL", "why URL", "report URL", "plot URL /odom"),
        *("convert URL out", "topic list --file URL", "recordings rm URL"),
        *("replay --what-if limits.linear_mps=0.2 URL", "gate --results URL"),
        *("info DIR", "verify DIR", "replay --check DIR", "clip DIR", "export DIR --topic /odom"),
        *("find --in DIR", "index DIR", "gate --in DIR", "why DIR"),
    ],
)
def test_any_other_url_is_answered_with_the_command_that_brings_it_here(
    cli: Cli, bucket: FaultyBucket, command: str
) -> None:
    url = URL if "URL" in command else "s3://robots/day"
    ran = cli(*(url if word in ("URL", "DIR") else word for word in command.split()))
    ran.failed(2, f"{url} is not on this computer: first robotctl sync {url} DIR")
    assert bucket.requests == 0


def test_a_web_server_gives_single_files(cli: Cli, bucket: FaultyBucket) -> None:
    folder = f"{bucket.endpoint}/robots/day/stopped"
    assert f"{folder}/{FILE.name}" in cli("info", f"{folder}/{FILE.name}").out
    assert "other.mcap does not exist" in cli("info", f"{folder}/other.mcap").err
    assert cli("sync", f"{folder}/{FILE.name}", "here").exit_code == 0
    assert (Path("here") / FILE.name).read_bytes() == FILE.read_bytes()
    assert "accepts no files" in cli("sync", "--recordings", str(STOPPED), folder).err


def test_status_and_files_here_need_no_library_of_stores(tmp_path: Path) -> None:
    program = (
        "import sys; from robotctl.cli import app; app.run(sys.argv[1:]);"
        "sys.exit('obstore' in sys.modules or 'asyncio' in sys.modules)"
    )
    for words in (["status"], ["info", str(STOPPED)]):
        subprocess.run([sys.executable, "-c", program, *words], check=True, capture_output=True)


def test_a_clip_of_a_url_is_written_here_and_compared_to_it(cli: Cli, bucket: FaultyBucket) -> None:
    assert cli("clip", URL, "--event", "estop", "--json").exit_code == 0
    (clip,) = Path().glob("*.mcap")
    assert clip.name.startswith(f"{FILE.stem}_estop_")
    assert cli("verify", str(clip), "--source", URL).exit_code == 4
    assert len(bucket.objects) == len(list(STOPPED.iterdir()))


def test_a_url_of_nothing_is_an_unreadable_file(cli: Cli, bucket: FaultyBucket) -> None:
    ran = cli("info", "s3://robots/elsewhere.mcap")
    assert (ran.exit_code, ran.err) == (6, "robotctl: s3://robots/elsewhere.mcap does not exist\n")


def test_failures_of_five_percent_change_no_check(cli: Cli, bucket: FaultyBucket) -> None:
    here = cli("replay", "--check", str(FILE))
    bucket.failing_share = bucket.short_share = 0.05
    for _ in range(10):
        there = cli("replay", "--check", URL, "--all-bytes")
        assert there.out == here.out.replace(str(FILE), URL)
    assert bucket.requests > 20


def test_a_recording_replaced_during_a_check_is_told(cli: Cli, bucket: FaultyBucket) -> None:
    def replace(served: FaultyBucket, method: str, key: str) -> None:
        if method == "GET" and key.endswith(".mcap"):
            served[key] = b"x" * len(served.objects[key])

    bucket.before = replace
    cli("replay", "--check", URL).failed(6, out=f"{FILE.name} was changed while it was read")


def test_no_message_shows_a_key(cli: Cli, bucket: FaultyBucket) -> None:
    bucket.before = lambda served, method, key: 403
    err = cli("info", URL).failed(6, "access is denied: set AWS_ACCESS_KEY_ID")
    assert "very-secret" not in err
    assert "AKIDEXAMPLE" not in err


def test_the_cure_of_a_damaged_recording_in_a_store_begins_with_a_download(
    cli: Cli, bucket: FaultyBucket
) -> None:
    (path,) = STOPPED.glob("*.mcap")
    bucket["damaged.mcap"] = path.read_bytes()[:-2000]
    cli("info", "s3://robots/damaged.mcap").failed(
        6, "download it, and save what can be read with robotctl recover"
    )
