"""Recordings in a store: the offline commands say what they say of the same files here."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.cli.conftest import Ran
from tests.support.faulty_bucket import FaultyBucket, serving

Cli = Callable[..., Ran]

STOPPED = Path(__file__).parents[1] / "golden" / "stopped"
URL = "s3://robots/day/stopped"


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
        "info PATH",
        "info PATH --json",
        "replay --check PATH --all-bytes",
        "verify PATH",
        "why PATH",
        "topic list --file PATH",
        "topic echo --file PATH /odom --once",
        "topic echo --file PATH /odom --json",
        "export PATH --topic /odom --json",
        "replay --what-if limits.linear_mps=0.2 PATH",
    ],
)
def test_a_command_says_of_a_url_what_it_says_of_the_folder(
    cli: Cli, bucket: FaultyBucket, command: str
) -> None:
    here = cli(*command.replace("PATH", str(STOPPED)).split())
    there = cli(*command.replace("PATH", URL).split())
    assert here.out
    assert there.out == here.out.replace(str(STOPPED), URL)
    assert there.exit_code == here.exit_code
    assert there.err == here.err.replace(str(STOPPED), URL)


def test_a_folder_of_recordings_and_one_file_are_named_by_urls_too(
    cli: Cli, bucket: FaultyBucket
) -> None:
    (name,) = (path.name for path in STOPPED.glob("*.mcap"))
    (here,) = json.loads(cli("replay", "--check", str(STOPPED), "--json").out)["recordings"]
    bucket["day/stopped/"] = b""  # which a console makes
    for url in ("s3://robots/day", f"{URL}/{name}", f"{URL}/"):
        (found,) = json.loads(cli("replay", "--check", url, "--json").out)["recordings"]
        assert found["events"] > 0
        assert (found["verdict"], found["events"]) == (here["verdict"], here["events"])


def test_what_sync_has_copied_is_read_there(cli: Cli, bucket: FaultyBucket, tmp_path: Path) -> None:
    folder = tmp_path / "recordings" / "robot_20261122_041522"
    shutil.copytree(STOPPED, folder)
    assert cli("sync", "s3://robots/all", "--recordings", str(folder.parent)).exit_code == 0
    (file,) = folder.glob("*.mcap")
    for here, url in (
        (folder, "s3://robots/all/robot_20261122_041522"),
        (file, f"s3://robots/all/robot_20261122_041522/{file.name}"),
    ):
        assert cli("info", url).out == cli("info", str(here)).out.replace(str(here), url)
    (found,) = json.loads(cli("replay", "--check", "s3://robots/all", "--json").out)["recordings"]
    assert found["path"] == "s3://robots/all/robot_20261122_041522"


def test_a_web_server_gives_single_files(cli: Cli, bucket: FaultyBucket) -> None:
    (name,) = (path.name for path in STOPPED.glob("*.mcap"))
    folder = f"{bucket.endpoint}/robots/day/stopped"
    assert f"{folder}/{name}" in cli("info", f"{folder}/{name}").out
    ran = cli("info", folder)
    assert ran.exit_code == 6
    assert "does not exist: name the file: a server lists no folders" in ran.err
    assert "other.mcap does not exist: check the URL" in cli("info", f"{folder}/other.mcap").err


def test_status_and_files_here_need_no_library_of_stores(tmp_path: Path) -> None:
    program = (
        "import sys; from robotctl.cli import app; app.run(sys.argv[1:]);"
        "sys.exit('obstore' in sys.modules or 'asyncio' in sys.modules)"
    )
    for words in (["status"], ["info", str(STOPPED)]):
        subprocess.run([sys.executable, "-c", program, *words], check=True, capture_output=True)


def test_what_is_made_of_a_url_is_written_here(cli: Cli, bucket: FaultyBucket) -> None:
    assert cli("clip", URL, "--event", "estop", "--json").exit_code == 0
    assert cli("report", URL).exit_code == 0
    (clip,) = Path().glob("*.mcap")
    (page,) = Path().glob("*.html")
    assert clip.name.startswith("stopped_estop_")
    assert page.name == "stopped.report.html"
    assert "robotctl verify URL" in page.read_text()
    assert cli("verify", str(clip), "--source", URL).exit_code == 4
    assert len(bucket.objects) == len(list(STOPPED.iterdir()))


@pytest.mark.parametrize("command", ["recover", "replay", "recordings rm"])
def test_a_command_that_needs_a_file_of_this_computer_says_so(
    cli: Cli, bucket: FaultyBucket, command: str
) -> None:
    ran = cli(*command.split(), URL)
    assert (ran.exit_code, ran.err) == (
        2,
        f"robotctl: {URL} is not on this computer, as this needs: download it first\n",
    )


def test_a_url_of_nothing_is_an_unreadable_file(cli: Cli, bucket: FaultyBucket) -> None:
    ran = cli("info", "s3://robots/elsewhere")
    assert (ran.exit_code, ran.err) == (
        6,
        "robotctl: s3://robots/elsewhere does not exist: check the URL\n",
    )


def test_failures_of_five_percent_change_no_check(cli: Cli, bucket: FaultyBucket) -> None:
    here = cli("replay", "--check", str(STOPPED))
    bucket.failing_share = bucket.short_share = 0.05
    for _ in range(5):
        there = cli("replay", "--check", URL, "--all-bytes")
        assert there.out == here.out.replace(str(STOPPED), URL)
    assert bucket.requests > 20


def test_a_recording_that_is_replaced_during_a_check_is_told(
    cli: Cli, bucket: FaultyBucket
) -> None:
    def replace(served: FaultyBucket, method: str, key: str) -> None:
        if method == "GET" and key.endswith(".mcap"):
            served[key] = b"x" * len(served.objects[key])

    bucket.before = replace
    ran = cli("replay", "--check", URL)
    assert ran.exit_code == 6
    assert re.search(r"not checked: .*_0\.mcap was changed while it was\s+read", ran.out)


def test_a_recording_that_vanishes_during_a_check_is_told(cli: Cli, bucket: FaultyBucket) -> None:
    def vanish(served: FaultyBucket, method: str, key: str) -> None:
        if method == "GET" and key.endswith(".mcap"):
            served.objects.pop(key, None)

    bucket.before = vanish
    ran = cli("replay", "--check", URL)
    assert ran.exit_code == 6
    assert re.search(r"not checked: .*_0\.mcap does not\s+exist", ran.out)


def test_a_claimed_size_of_a_petabyte_ends_with_a_sentence(
    cli: Cli, bucket: FaultyBucket, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robotctl.store.remote_store.MAX_RETRIES", 1)
    bucket.lying_size = 10**15
    (name,) = (path.name for path in STOPPED.glob("*.mcap"))
    ran = cli("info", f"{URL}/{name}")
    assert ran.exit_code == 6
    assert len(ran.err.splitlines()) == 1


def test_no_message_shows_a_key(cli: Cli, bucket: FaultyBucket) -> None:
    bucket.before = lambda served, method, key: 403
    ran = cli("info", URL)
    assert ran.exit_code == 6
    assert "access is denied: set AWS_ACCESS_KEY_ID" in ran.err  # the answer to HEAD has no text
    assert "very-secret" not in ran.err
    assert "AKIDEXAMPLE" not in ran.err


def test_the_cure_of_a_damaged_recording_in_a_store_begins_with_a_download(
    cli: Cli, bucket: FaultyBucket
) -> None:
    (path,) = STOPPED.glob("*.mcap")
    bucket["damaged.mcap"] = path.read_bytes()[:-2000]
    ran = cli("info", "s3://robots/damaged.mcap")
    assert ran.exit_code == 6
    assert "download it, and save what can be read with robotctl recover" in ran.err
