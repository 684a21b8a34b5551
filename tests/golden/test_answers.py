"""Every later version answers about sealed recordings of version 0.2.0 as that version did.

`answers/` holds what the version that made the recordings printed, with the exit codes.
`python tests/golden/test_answers.py` wrote it, by a Python that had that version. It is not written
with a later one: what changes on purpose is a row of `GIVEN_UP`.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path

import pytest

from robotctl.check.report import rounded
from robotctl.cli import app

GOLDEN = Path(__file__).parent
ANSWERS = GOLDEN / "answers"
MAX_BYTES = 1_500_000

SPLIT = "sealed/robot_20261129_065606"
CLIPS = (
    f"{SPLIT}/clips/robot_20261129_065606_estop_065609.mcap",
    "sealed/robot_20261129_065626/clips/robot_20261129_065626_estop_065629.mcap",
)
RECORDINGS = (
    *(f"sealed/{path.name}" for path in sorted((GOLDEN / "sealed").glob("robot_*"))),
    *CLIPS,
    "left_by_kill",
)
OLD = ("stopped", "killed", "foreign")
GATES = [
    f"gate --in sealed --results results_{number} --baseline sealed_state/baseline.json{options}"
    for number, options in enumerate(
        (
            " --what-if limits.linear_mps=0.3",
            " --what-if limits.linear_mps=0.3 --json",
            " --what-if limits.linear_mps=0.2",
            " --json",
        )
    )
]

COMMANDS = {
    "info": [f"info {name} --json" for name in RECORDINGS],
    "verify": [
        *(f"verify {name}" for name in (*RECORDINGS, *OLD, "sealed")),
        "verify sealed --json",
        f"verify {CLIPS[0]} --source {SPLIT}",
        f"verify {CLIPS[1]} --source {SPLIT}",
        f"verify sealed --head {'0' * 64}",
    ],
    "check": [f"replay --check {name}{json}" for name in RECORDINGS for json in ("", " --json")]
    + ["replay --check sealed"],
    "why": [f"why {name}{json}" for name in (*RECORDINGS, *OLD) for json in ("", " --json")]
    + [f"why {SPLIT} --at 0", "why sealed/robot_20261129_065619 --at 1.5"],
    "many": [
        "recordings --recordings sealed --json",
        "find \"cause == 'operator stop'\" --in sealed --json",
        "index sealed",
        *GATES,
        "evidence --recordings sealed --json",
    ],
}
"""What is asked, by the file of `answers/` that holds the answers."""

GIVEN_UP: tuple[tuple[str, str, str], ...] = (
    (r'"shadow": "", ', "", "why: no daemon has a second kernel any more"),
    (r'"gaps": \[\], ', "", "evidence: the seal proves it, no search of its own"),
)
"""Rows of a regular expression over the answers of 0.2.0, what stands there now, and why."""

LEFT_OUT = (
    (r'("[\w/]+\.py": "[0-9a-f]{16}"(, )?)+', '"MODULES": ""'),  # in the metadata of each file
    (r'"software": "[0-9a-f]{64}"', '"software": "DIGEST"'),  # of a gate's result: this robotctl
    (r'"took_s": [0-9.e-]+', '"took_s": 0'),
)
"""What the answers do not hold: the hashes of modules, and how long a check takes."""

ROUNDED_BY_LIBM = (
    (r"\n +note: made with Python [^\n]* to 1e-09", ""),
    (r'"made with Python [^"]* to 1e-09"(, )?', ""),
    (r"compared (bit for bit|as far as they can be compared)", "compared"),
    (r'"bitwise": (true|false)', '"bitwise": true'),
)
"""What is said of a recording whose floats are of a C library; 0.2.0 had the same one."""


def answer(command: str) -> str:
    """Return a command line, all that it prints, and its exit code."""
    out, err = StringIO(), StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = app.run(shlex.split(command))
    said = out.getvalue() + "".join(f"! {line}\n" for line in err.getvalue().splitlines())
    said = said.replace(os.getcwd(), "FOLDER")
    for pattern, text in LEFT_OUT:
        said = re.sub(pattern, text, said)
    return without_arithmetic(f"$ robotctl {command}\n{said}[exit {code}]\n")


def without_arithmetic(answer: str) -> str:
    """Return an answer without what it says about the arithmetic of a recording."""
    for pattern, text in ROUNDED_BY_LIBM:
        answer = re.sub(pattern, text, answer)
    return rounded(answer)


def read_answers() -> dict[str, str]:
    """Return the golden answers by command, without what was given up."""
    answers = {}
    for path in ANSWERS.glob("*.txt"):
        for part in path.read_text().split("\n\n"):
            command, _, _ = part.partition("\n")
            answers[command.removeprefix("$ robotctl ")] = part.rstrip("\n") + "\n"
    answers = {name: without_arithmetic(said) for name, said in answers.items()}
    for pattern, text, _ in GIVEN_UP:
        answers = {name: re.sub(pattern, text, said) for name, said in answers.items()}
    return answers


@contextmanager
def golden_folder(folder: Path) -> Iterator[None]:
    """Work in a copy of the golden recordings, with the state of their robot and in UTC."""
    patch = pytest.MonkeyPatch()
    robot = folder / "state" / "robotctl" / "robot"
    for name in ("sealed", "sealed_state", "left_by_kill", *OLD):
        shutil.copytree(GOLDEN / name, folder / name)
    for name in ("seal", "decisions"):
        shutil.copytree(GOLDEN / "sealed_state" / name, robot / name)
    for path in (*folder.rglob("*"), folder):
        path.chmod(0o700 if path.is_dir() else 0o600)
    (folder / "run").mkdir(mode=0o700)
    try:
        patch.setenv("XDG_STATE_HOME", str(folder / "state"))
        patch.setenv("XDG_RUNTIME_DIR", str(folder / "run"))
        patch.setenv("COLUMNS", "100")
        patch.setenv("TZ", "UTC")
        time.tzset()
        with chdir(folder):
            yield
    finally:
        patch.undo()
        time.tzset()


@pytest.fixture(scope="module", autouse=True)
def copied(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The folder in which all commands of this file run."""
    with golden_folder(tmp_path_factory.mktemp("golden")):
        yield


GOLDEN_ANSWERS = read_answers()


def test_the_sealed_recordings_are_small_and_hold_no_private_key() -> None:
    kept = [
        path
        for name in ("sealed", "sealed_state", "left_by_kill")
        for path in (GOLDEN / name).rglob("*")
        if path.is_file()
    ]
    assert sum(path.stat().st_size for path in kept) <= MAX_BYTES
    assert [path for path in kept if path.name == "key.json"] == []


@pytest.mark.parametrize("command", [each for group in COMMANDS.values() for each in group])
def test_the_answer_and_the_exit_code_stay(command: str) -> None:
    assert answer(command) == GOLDEN_ANSWERS[command]


def write() -> None:
    """Write the golden answers with the version that is installed."""
    ANSWERS.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory(dir="/tmp") as folder, golden_folder(Path(folder)):
        for name, commands in COMMANDS.items():
            text = "\n".join(answer(command) for command in commands)
            (ANSWERS / f"{name}.txt").write_text(text)


if __name__ == "__main__":
    write()
