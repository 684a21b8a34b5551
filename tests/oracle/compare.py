"""Compares what two versions of robotctl say of mutated recordings.

    python tests/oracle/compare.py OLD_PYTHON NEW_PYTHON --count 1000 --kept /tmp/oracle

Each python has a robotctl. The same files come out of the golden recordings by their numbers, and
each side reads them in one process of its own. The answers are kept by side as JSON: those of the
old version are made once. What differs is listed but where `EXCEPTIONS` gives a reason; the exit
code is 1 if anything is.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from contextlib import chdir, redirect_stderr, redirect_stdout
from hashlib import sha256
from io import StringIO
from pathlib import Path
from random import Random
from typing import Any, Final

import zstandard
from mcap.reader import make_reader

GOLDEN: Final = Path(__file__).parents[1] / "golden"
FOLDERS: Final = ("sealed", "left_by_kill", "stopped", "killed", "foreign")
MAX_S: Final = 60
"""How long one command may take."""

EXCEPTIONS: Final[tuple[tuple[str, str, str], ...]] = (
    ("why", r"\.shadow: ", "there is no second kernel, whose decision `why` would show"),
    (
        "check",
        r"\.missing: order",
        "one path meets a damage where it is read, after what it decided",
    ),
    ("check", r'\.missing\[\d+\]: "and more"', "a list that was full has room"),
)
"""Command, a regular expression of a difference as it is listed, and why it is right."""

GIVEN_UP: Final = re.compile(
    r"the schema of \S+ does not describe the fields|log times go back \d+ times"
    r"|\d+ commands without a decision|robot statuses are wrong|did not number what it sent"
    r"|the events in the metadata differ"
)
"""Sentences of a check that searched for forgery, which the seal answers now."""

FOLLOWS_FROM_A_VIOLATION: Final = re.compile(
    r"\.(verdict|violation_count|broken|incomplete|exit|error\.\w+|errors\[\d+\]): "
)

# Mutations: by bytes, by records of the file, and by records within a chunk

_MAGIC: Final = 8
_HEAD: Final = struct.Struct("<BQ")
_CHUNK: Final = 6

Records = list[bytes]


def flip_bits(data: bytes, random: Random) -> bytes:
    """Flip one to three bits."""
    changed = bytearray(data)
    for _ in range(random.choice((1, 1, 2, 3))):
        changed[random.randrange(len(changed))] ^= 1 << random.randrange(8)
    return bytes(changed)


def truncate(data: bytes, random: Random) -> bytes:
    """Cut the end off."""
    return data[: random.randrange(len(data))]


def zero(data: bytes, random: Random) -> bytes:
    """Write zeros over a range, as a disk that lost blocks."""
    begin = random.randrange(len(data))
    end = min(len(data), begin + random.choice((1, 16, 512, 4096)))
    return data[:begin] + bytes(end - begin) + data[end:]


def duplicate(records: Records, random: Random) -> Records:
    """Write a record twice."""
    at = random.randrange(len(records))
    return [*records[: at + 1], *records[at:]]


def remove(records: Records, random: Random) -> Records:
    """Leave a record out."""
    at = random.randrange(len(records))
    return [*records[:at], *records[at + 1 :]]


def swap(records: Records, random: Random) -> Records:
    """Exchange two neighbours."""
    at = random.randrange(max(len(records) - 1, 1))
    return [*records[:at], *records[at + 1 : at + 2], records[at], *records[at + 2 :]]


def change(records: Records, random: Random) -> Records:
    """Flip a bit of a record's content."""
    at = random.randrange(len(records))
    head, content = records[at][: _HEAD.size], records[at][_HEAD.size :]
    changed = flip_bits(content, random) if content else content
    return [*records[:at], head + changed, *records[at + 1 :]]


def split(data: bytes) -> Records:
    """Return the records of a file or chunk; what follows the last whole one is one, too."""
    records, at = [], 0
    while at + _HEAD.size <= len(data):
        end = at + _HEAD.size + _HEAD.unpack_from(data, at)[1]
        if end > len(data):
            break
        records.append(data[at:end])
        at = end
    return [*records, data[at:]] if at < len(data) else records


def in_file(edit: Callable[[Records, Random], Records]) -> Callable[[bytes, Random], bytes]:
    """Edit the records of a file."""

    def edited(data: bytes, random: Random) -> bytes:
        return data[:_MAGIC] + b"".join(edit(split(data[_MAGIC:]), random))

    return edited


def in_chunk(edit: Callable[[Records, Random], Records]) -> Callable[[bytes, Random], bytes]:
    """Edit the records of a chunk, which is written without a CRC; its index stays as it was."""

    def edited(data: bytes, random: Random) -> bytes:
        records = split(data[_MAGIC:])
        chunks = [at for at, record in enumerate(records) if record[0] == _CHUNK]
        if not chunks:
            return flip_bits(data, random)
        at = random.choice(chunks)
        content = records[at][_HEAD.size :]
        (name_bytes,) = struct.unpack_from("<I", content, 28)
        begin = 32 + name_bytes + 8
        if content[32 : 32 + name_bytes] != b"zstd":
            return flip_bits(data, random)
        inner = zstandard.ZstdDecompressor().decompressobj().decompress(content[begin:])
        inner = b"".join(edit(split(inner), random))
        packed = zstandard.ZstdCompressor().compress(inner)
        content = (
            content[:16]
            + struct.pack("<QI", len(inner), 0)
            + content[28 : 32 + name_bytes]
            + struct.pack("<Q", len(packed))
            + packed
        )
        records[at] = _HEAD.pack(_CHUNK, len(content)) + content
        return data[:_MAGIC] + b"".join(records)

    return edited


MUTATIONS: Final[dict[str, Callable[[bytes, Random], bytes]]] = {
    "flipped bits": flip_bits,
    "truncated": truncate,
    "zeroed": zero,
    "record twice": in_file(duplicate),
    "record removed": in_file(remove),
    "records swapped": in_file(swap),
    "record changed": in_file(change),
    "twice in a chunk": in_chunk(duplicate),
    "removed in a chunk": in_chunk(remove),
    "swapped in a chunk": in_chunk(swap),
    "changed in a chunk": in_chunk(change),
}


def mutated(number: int, files: list[Path]) -> tuple[str, Path, bytes]:
    """Return the mutation, the original and the content of the file of a number."""
    random = Random(number)
    kind = random.choice(list(MUTATIONS))
    path = random.choice(files)
    return kind, path, MUTATIONS[kind](path.read_bytes(), random)


# One side


def answers(first: int, count: int) -> dict[str, Any]:
    """Return what this robotctl says of each file, by its number."""
    files = [path for name in FOLDERS for path in sorted((GOLDEN / name).rglob("*.mcap"))]
    said: dict[str, Any] = {}
    with tempfile.TemporaryDirectory(prefix="or-", dir="/tmp") as place:
        folder = Path(place)
        prepare(folder)
        with chdir(folder):
            for number in range(first, first + count):
                kind, path, data = mutated(number, files)
                run = Path("run")
                run.mkdir()
                (run / path.name).write_bytes(data)
                file = str(run / path.name)
                said[str(number)] = {
                    "mutation": f"{kind} of {path.name}",
                    "info": answer("info", file),
                    "verify": answer("verify", file),
                    "check": answer("replay", "--check", file),
                    "why": answer("why", file),
                    "recover": answer("recover", file, "-o", "recovered.mcap"),
                }
                if (recovered := Path("recovered.mcap")).exists():
                    said[str(number)]["recover"]["written"] = written(recovered)
                    recovered.unlink()
                shutil.rmtree(run)
    return said


def prepare(folder: Path) -> None:
    """Give this process the state of the robot of the golden recordings."""
    robot = folder / "state" / "robotctl" / "robot"
    for name in ("seal", "decisions"):
        shutil.copytree(GOLDEN / "sealed_state" / name, robot / name)
    (folder / "runtime").mkdir()
    for path in (*folder.rglob("*"), folder):
        path.chmod(0o700 if path.is_dir() else 0o600)
    os.environ["XDG_STATE_HOME"] = str(folder / "state")
    os.environ["XDG_RUNTIME_DIR"] = str(folder / "runtime")
    os.environ |= {"COLUMNS": "100", "TZ": "UTC"}


def answer(*arguments: str) -> dict[str, Any]:
    """Return the exit code, the JSON and the errors of a command."""
    from robotctl.cli import app

    def end(*_: object) -> None:
        raise TimeoutError(f"longer than {MAX_S} s")

    out, err = StringIO(), StringIO()
    signal.signal(signal.SIGALRM, end)
    signal.alarm(MAX_S)
    try:
        with redirect_stdout(out), redirect_stderr(err):
            code = app.run([*arguments, "--json"])
    finally:
        signal.alarm(0)
    lines = [json.loads(line) for line in out.getvalue().splitlines()]
    text = json.dumps({"exit": code, "said": lines, "errors": err.getvalue().splitlines()})
    return json.loads(re.sub(r'"took_s": [0-9.e-]+', '"took_s": 0', text))  # type: ignore[no-any-return]


def written(recovered: Path) -> dict[str, Any]:
    """Return what another reader finds in a recovered file."""
    digest, counts = sha256(), Counter[str]()
    with recovered.open("rb") as stream:
        reader = make_reader(stream)
        for _, channel, message in reader.iter_messages(log_time_order=False):
            counts[channel.topic] += 1
            digest.update(f"{channel.topic} {message.log_time} {message.sequence} ".encode())
            digest.update(message.data)
        names = [record.name for record in reader.iter_metadata()]
    return {"messages": dict(counts), "digest": digest.hexdigest(), "metadata": sorted(names)}


# Both sides


def differences(old: Any, new: Any, at: str = "") -> Iterator[str]:
    """Yield a line for each value that differs."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted({*old, *new}):
            yield from differences(old.get(key, "no key"), new.get(key, "no key"), f"{at}.{key}")
    elif isinstance(old, list) and isinstance(new, list):
        kept = [[each for each in side if not is_given_up(each)] for side in (old, new)]
        if [*map(len, kept)] != [len(old), len(new)]:
            old, new = (side[: min(map(len, kept))] for side in kept)
        if len(old) != len(new):
            yield f"{at}: {json.dumps(old)} -> {json.dumps(new)}"
            return
        if old != new and sorted(map(json.dumps, old)) == sorted(map(json.dumps, new)):
            yield f"{at}: order"
            return
        for index, (before, after) in enumerate(zip(old, new, strict=True)):
            yield from differences(before, after, f"{at}[{index}]")
    elif old != new:
        yield f"{at}: {json.dumps(old)} -> {json.dumps(new)}"


def compare(old: dict[str, Any], new: dict[str, Any]) -> int:
    """Print the differences by command and key; return how many files differ without a reason."""
    excused: Counter[str] = Counter()
    found: dict[str, list[str]] = defaultdict(list)
    differing = set()
    for number, before in old.items():
        for command in [key for key in before if key != "mutation"]:
            only_given_up = all_given_up(before[command])
            for line in differences(before[command], new[number].get(command)):
                if only_given_up and FOLLOWS_FROM_A_VIOLATION.search(line):
                    excused["its only violation was found by a search for forgery"] += 1
                    continue
                if reason := reason_for(command, line):
                    excused[reason] += 1
                    continue
                key = re.sub(r"\d+", "N", f"{command}{line.partition(':')[0]}")
                found[key].append(f"{number}, {before['mutation']}\n      {line[:600]}")
                differing.add(number)
    for key, lines in sorted(found.items(), key=lambda item: -len(item[1])):
        print(f"{len(lines)} x {key}")
        for each in lines[:3]:
            print(f"    file {each}")
    for reason, times in excused.items():
        print(f"excused {times} x: {reason}")
    print(f"{len(differing)} of {len(old)} files differ without a reason")
    return len(differing)


def all_given_up(answer: dict[str, Any]) -> bool:
    """Return whether a check found violations, all by a search that is given up."""
    recordings = [each for said in answer["said"] for each in said.get("recordings", [])]
    found = [each for recording in recordings for each in recording.get("violations") or []]
    return bool(found) and all(map(is_given_up, found))


def is_given_up(finding: Any) -> bool:
    """Return whether this sentence, or violation with its text, is of a search for forgery."""
    text = finding.get("text", "") if isinstance(finding, dict) else finding
    return isinstance(text, str) and GIVEN_UP.search(text) is not None


def reason_for(command: str, line: str) -> str:
    """Return why a difference is right; "" if it is not."""
    for which, pattern, why in EXCEPTIONS:
        if which in (command, "*") and re.search(pattern, line):
            return why
    return ""


def made(python: str, kept: Path, first: int, count: int) -> dict[str, Any]:
    """Return the answers of a side, from `kept` if it has them."""
    if not kept.exists():
        kept.parent.mkdir(parents=True, exist_ok=True)
        part = kept.with_suffix(".part")
        numbers = ["--first", str(first), "--count", str(count)]
        with part.open("w") as stream:
            subprocess.run([python, __file__, "--answer", *numbers], stdout=stream, check=True)
        part.rename(kept)
    return json.loads(kept.read_text())  # type: ignore[no-any-return]


def main() -> None:
    """Make the answers of one side, or compare two."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("old", nargs="?")
    parser.add_argument("new", nargs="?")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--kept", type=Path, default=Path("/tmp/oracle"))
    parser.add_argument("--answer", action="store_true", help="make the answers of this python")
    chosen = parser.parse_args()
    if chosen.answer:
        json.dump(answers(chosen.first, chosen.count), sys.stdout)
        return
    name = f"{chosen.first}-{chosen.count}.json"
    old = made(chosen.old, chosen.kept / f"old-{name}", chosen.first, chosen.count)
    (chosen.kept / f"new-{name}").unlink(missing_ok=True)
    new = made(chosen.new, chosen.kept / f"new-{name}", chosen.first, chosen.count)
    sys.exit(compare(old, new) > 0)


if __name__ == "__main__":
    main()
