"""`verify` and `key`, and files in which a power cut has left zeros: answers and exit codes."""

from __future__ import annotations

from pathlib import Path

import pytest

from robotctl.base.paths import make_private, seal_folder
from robotctl.recording.seal import KEY_FILE, Keyring
from robotctl.testing.drives import drive, record
from robotctl.testing.faults import chunks_of, zero
from tests.cli.conftest import Cli
from tests.support.recordings import flip, foreign, record_sealed, recorded


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    return recorded(tmp_path / "run", 100).parent


def test_a_whole_recording_without_a_seal_exits_with_4(recording: Path, cli: Cli) -> None:
    ran = cli("verify", str(recording))
    ran.failed(4, "not sealed", out="100 messages, finished")
    assert ran.out.splitlines()[0].split() == ["whole", str(recording)]


def test_a_file_of_the_mcap_library_is_whole_though_it_names_groups_without_records(
    tmp_path: Path, cli: Cli
) -> None:
    ran = cli("verify", str(foreign(tmp_path / "library.mcap", 1)))
    assert ran.out.splitlines()[0].split() == ["whole", str(tmp_path / "library.mcap")]
    assert ran.exit_code == 4


def test_a_flipped_bit_exits_with_7_and_its_byte_is_named(recording: Path, cli: Cli) -> None:
    (file,) = recording.glob("*.mcap")
    flip(file, 30, 2)
    ran = cli("verify", str(recording), "--json")
    ran.failed(7)
    (report,) = ran.summary["recordings"]
    assert report["verdict"] == "broken"
    assert any(flaw["start"] <= 30 < flaw["end"] for flaw in report["files"][0]["flaws"])


def test_what_is_no_recording_exits_with_6_also_among_others(
    recording: Path, tmp_path: Path, cli: Cli
) -> None:
    (tmp_path / "x.mcap").write_bytes(b"nothing")
    cli("verify", str(recording), str(tmp_path / "x.mcap")).failed(6, out="not an MCAP file")


@pytest.fixture
def keys() -> Keyring:
    return Keyring(make_private(seal_folder("robot")), "robot")


def test_a_robot_that_never_started_has_no_key(cli: Cli) -> None:
    for command in ("show", "head", "rotate"):
        cli("key", command).failed(4, "no key yet")
        assert not seal_folder("robot").exists()


def test_key_and_head_are_shown_without_the_secret(cli: Cli, keys: Keyring, tmp_path: Path) -> None:
    record_sealed(tmp_path / "run", keys)
    stored = keys.load()
    assert stored is not None
    out = cli("key", "show").succeeded(stored.root)
    assert cli("key", "head").out == f"{stored.head.digest}\n"
    assert cli("key", "head", "--json").summary["file"] == "run_0.mcap"
    assert stored.seed not in out + cli("key", "show", "--json").out


def test_a_head_that_is_known_proves_the_end(cli: Cli, keys: Keyring, tmp_path: Path) -> None:
    record_sealed(tmp_path / "run", keys)
    head = cli("key", "head").out.strip()
    cli("verify", str(tmp_path / "run"), "--head", head).succeeded(
        "the given head is in run_0.mcap", "this machine's list of keys knows 1 of 1 files"
    )
    other = "0" * 63 + "1"
    assert cli("verify", str(tmp_path / "run"), "--head", other).exit_code == 7
    assert cli("verify", str(tmp_path / "run"), "--head", "12").exit_code == 2


def test_rotate_begins_a_new_chain(cli: Cli, keys: Keyring) -> None:
    before = keys.rotate()
    assert cli("key", "rotate").exit_code == 0
    after = keys.load()
    assert after is not None
    assert after.root != before.root


def test_a_damaged_key_is_refused_with_the_path(cli: Cli, keys: Keyring) -> None:
    keys.rotate()
    (seal_folder("robot") / KEY_FILE).write_text("?")
    cli("key", "show").failed(4, KEY_FILE)


ZEROS = "the chunk was replaced by zeros, which a power cut can cause"


@pytest.fixture(scope="module")
def zeroed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    (path,) = record(tmp_path_factory.mktemp("cut") / "run", drive(3.0)).glob("*.mcap")
    chunks = chunks_of(path.read_bytes())
    assert len(chunks) > 4
    zero(path, *chunks[len(chunks) // 2])
    return path


@pytest.mark.parametrize(
    ("command", "exit_code"),
    [
        ("recover FILE -o out.mcap", 8),
        ("clip FILE --at 1 --before 86400 --after 86400 -o clip.mcap", 8),
        ("replay FILE --json --check", 6),
        ("replay FILE --json --what-if tracking.k_y=8", 6),
        ("why FILE --json", 4),
    ],
)
def test_no_command_takes_a_file_with_zeros_for_whole(
    zeroed: Path, cli: Cli, command: str, exit_code: int
) -> None:
    ran = cli(*command.replace("FILE", str(zeroed)).split())
    assert ran.exit_code == exit_code, ran.err
    assert "nothing lost" not in ran.out
    assert ZEROS in ran.out + ran.err
