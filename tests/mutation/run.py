"""Mutation test of `robotctl/kernel`: how many small changes of the code do its tests notice?

    python tests/mutation/run.py --count 300 --seed 1   300 mutants drawn by the seed
    python tests/mutation/run.py                        every mutant
    python tests/mutation/run.py --only drive.Drive     those of one module, class or function

cosmic-ray makes the mutants, in a copy of the tree; each one runs `tests/kernel` in a new process.
A mutant that no test notices has survived: write the test that is missing, or list the mutant in
`equivalent.toml` with the reason why nothing can notice it. The exit code is 1 when fewer than 95 %
of the mutants are killed or more than 3 % are listed as equivalent. A mutant that never ends is
killed by a limit of CPU time; such mutants are named.
"""

from __future__ import annotations

import argparse
import itertools
import multiprocessing
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, settings

sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.mutation.mutants import Key, Mutant, Site, equivalents, mutant_at, sites, stale_entries

TREE = Path(__file__).parents[2]

LEAST_KILLED, MOST_EQUIVALENT = 0.95, 0.03


RUN_LAST = ("test_codec.py", "test_driving.py", "test_properties.py")
"""The slow test files; those that import the changed module run first, and kill most mutants."""

CPU_S, WALL_S, MEMORY_BYTES = 240, 3600, 4 << 30
"""Limits of one run of the tests, which takes 25 to 60 s of CPU: a mutant may never end."""

LIMIT_CODE = 99
"""Exit code of a run that one of the limits ended."""

OPTIONS = "-x -q -n0 -p no:cacheprovider --hypothesis-profile=mutation"

_stamps_s = itertools.count(1)
"""Times of change, a new one for each mutant: bytecode that a test has cached is told by it."""


def main() -> int:
    """Draw, run and report."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, help="how many mutants to draw; default: all")
    parser.add_argument("--seed", type=int, default=1, help="of the draw; default: 1")
    parser.add_argument("--only", default="", help="a name such as drive. or drive.Drive.advance")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="robotctl-mutation-") as name:
        folder = copied(Path(name).resolve())
        every, listed = list(sites(folder)), equivalents()
        if stale := stale_entries(listed, every, folder):
            print("equivalent.toml lists what is not in the code:", *stale, sep="\n")
            return 1
        if exit_code(folder, "") != 0:
            print(f"the tests fail without a mutant:\n{(folder / 'output').read_text()}")
            return 1
        drawn = [site for site in every if site.where.startswith(options.only)]
        print(f"{options.count or 'all'} of {len(drawn)} mutants, seed {options.seed}")
        random.Random(options.seed).shuffle(drawn)
        return report(drawn[: options.count], listed, folder)


def copied(folder: Path) -> Path:
    """Copy into `folder` what the tests of the kernel need."""
    for name in ("robotctl", "tests", "docs"):
        shutil.copytree(TREE / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(TREE / "pyproject.toml", folder)
    return folder


def report(drawn: Sequence[Site], listed: Mapping[Key, str], folder: Path) -> int:
    """Run the mutants, print those that survive and the figures; return the exit code."""
    counts: Counter[str] = Counter()
    wrong = 0
    begin = time.monotonic()
    for number, site in enumerate(drawn, 1):
        mutant = mutant_at(site)
        is_listed = mutant.key in listed
        code = exit_code_with(mutant, folder)
        survived = code == 0
        counts["equivalent" if is_listed else "survived" if survived else "killed"] += 1
        if code == LIMIT_CODE:
            counts["of these by a limit"] += 1
            print(f"ended by a limit: {mutant.where}\n- {mutant.was}\n+ {mutant.now}")
        if is_listed is not survived:
            note = "survived" if survived else "listed as equivalent, but killed"
            print(f"{note}: {mutant.where}\n- {mutant.was}\n+ {mutant.now}")
            wrong += is_listed
        if number % 100 == 0 or number == len(drawn):
            minutes = (time.monotonic() - begin) / 60
            print(f"after {number} mutants, {minutes:.0f} min: {dict(counts)}", flush=True)
    killed, equivalent = (counts[name] / len(drawn) for name in ("killed", "equivalent"))
    print(f"{killed:.1%} killed, {equivalent:.1%} equivalent")
    return int(wrong > 0 or killed < LEAST_KILLED or equivalent > MOST_EQUIVALENT)


def exit_code_with(mutant: Mutant, folder: Path) -> int:
    """Run the tests of the copy in `folder` with a mutant; return their exit code."""
    path, original = mutant.path, mutant.path.read_text()
    try:
        _write(path, mutant.code)
        return exit_code(folder, path.stem)
    finally:
        _write(path, original)


def _write(path: Path, code: str) -> None:
    path.write_text(code)
    stamp_s = next(_stamps_s)
    os.utime(path, (stamp_s, stamp_s))


def exit_code(folder: Path, changed: str) -> int:
    """Run the tests of the kernel in a new process: first those that import `changed`."""
    files = sorted(
        (folder / "tests/kernel").glob("test_*.py"), key=lambda each: each.name in RUN_LAST
    )
    near = [
        each
        for each in files
        if each.name not in RUN_LAST and f"kernel.{changed} import" in each.read_text()
    ]
    groups = near, [each for each in files if each not in near]
    fork = multiprocessing.get_context("fork")
    process = fork.Process(target=_test, args=(folder, groups), daemon=True)
    process.start()
    process.join(WALL_S)
    process.kill()
    process.join()
    code = process.exitcode
    return LIMIT_CODE if code is None or code < 0 else code


def _test(folder: Path, groups: Iterable[Sequence[Path]]) -> None:
    signal.signal(signal.SIGXCPU, _end_tests)
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_S, CPU_S + 10))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    _import_from(folder)
    code = 0
    for files in filter(None, groups):
        ignored = ["-W", "ignore::pytest.PytestAssertRewriteWarning"]  # it is imported above
        code = code or pytest.main([*OPTIONS.split(), *ignored, *map(str, files)])
    # isort: split
    import robotctl

    assert Path(robotctl.__file__ or "").is_relative_to(folder), robotctl.__file__
    os._exit(code)


def _end_tests(*_signal: object) -> None:
    pytest.exit("too much CPU time", LIMIT_CODE)


def _import_from(folder: Path) -> None:
    """Let this process import from the copy in `folder`, and write what it prints there."""
    with (folder / "output").open("w") as output:
        os.dup2(output.fileno(), 1)
        os.dup2(output.fileno(), 2)
    os.chdir(folder)
    for variable in ("PYTHONPATH", "LD_LIBRARY_PATH", "AMENT_PREFIX_PATH"):
        os.environ.pop(variable, None)  # for a sourced ROS the tests would start this script again
    # An editable install finds its modules before sys.path does: those of the tree, not the copy.
    sys.meta_path[:] = [each for each in sys.meta_path if "editable" not in type(each).__module__]
    sys.path.insert(0, str(folder))
    settings.register_profile(
        "mutation",
        derandomize=True,
        database=None,
        deadline=None,
        phases=(Phase.explicit, Phase.generate),  # how a mutant fails need not be made simple
        suppress_health_check=[HealthCheck.too_slow],
    )


if __name__ == "__main__":
    sys.exit(main())
