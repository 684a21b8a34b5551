"""Mutation test of `robotctl/kernel`: how many small changes of the code do its tests notice?

    python tests/mutation/run.py --count 300 --seed 1   300 mutants drawn by the seed
    python tests/mutation/run.py                        every mutant: more than an hour
    python tests/mutation/run.py --part 3/16            every 16th mutant, from the third on
    python tests/mutation/run.py --only drive.Drive     those of one module, class or function

cosmic-ray makes the mutants, in a copy of the tree; each one runs `tests/kernel`. A mutant that no
test notices has survived: write the test that is missing, or list the mutant in `equivalent.toml`
with the reason why nothing can notice it. The exit code is 1 when fewer than 95 % of the mutants
are killed or more than 3 % are listed as equivalent. A mutant that never ends is killed by a limit
of time; such mutants are named, because on a busy machine a limit may end honest tests too.
"""

from __future__ import annotations

import argparse
import ast
import difflib
import multiprocessing
import os
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest
from cosmic_ray import plugins
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from hypothesis import HealthCheck, Phase, settings

TREE = Path(__file__).parents[2]
KERNEL = Path("robotctl/kernel")
TESTS = Path("tests/kernel")

RUN_LAST = ("test_codec.py", "test_driving.py", "test_properties.py")
"""The slow test files; those that import the changed module run first, and kill most mutants."""

NOT_MUTANTS = re.compile(
    # TypeError on floats, whatever the tests are: these would flatter the figure.
    r"core/ReplaceBinaryOperator_(\w+_(RShift|LShift|BitOr|BitAnd|BitXor)|BitOr_\w+)"
    # Members of an enum and classes are compared with `is`: equal is the same, order a TypeError.
    r"|core/ReplaceComparisonOperator_(Is|IsNot)_(?!Is)\w+"
    # `is` between numbers depends on the interpreter.
    r"|core/ReplaceComparisonOperator_(?!Is)[A-Za-z]+_(Is|IsNot)"
)
"""Operators of cosmic-ray that say nothing about the tests."""

LEAST_KILLED, MOST_EQUIVALENT = 0.95, 0.03

CPU_S, WALL_S, MEMORY_BYTES = 120, 1800, 4 << 30
"""Limits of one run of the tests, which takes 20 to 30 s of CPU: a mutant may never end."""

LIMIT_CODE = 99
"""Exit code of a run that one of the limits ended."""


Key = tuple[str, str, str]
"""An entry of equivalent.toml: definition, lines before, lines after."""


@dataclass(frozen=True, slots=True)
class Site:
    """Where a mutant can be made: the `occurrence`-th place for this operator of cosmic-ray.

    `where` is the definition around it: module.Class.function.
    """

    path: Path
    operator: str
    occurrence: int
    where: str


@dataclass(frozen=True, slots=True)
class Mutant:
    """The code of a module with one change: in `where`, `was` became `now`."""

    code: str
    where: str
    was: str
    now: str

    @property
    def key(self) -> Key:
        """What `equivalent.toml` names it by; line numbers would change too often."""
        return self.where, self.was, self.now


def sites(folder: Path) -> Iterator[Site]:
    """Yield every site of the kernel in `folder`, always in the same order."""
    for path in sorted((folder / KERNEL).rglob("*.py")):
        source = path.read_text()
        places = _Places(path, folder)
        nodes = list(ast_nodes(get_ast(source)))
        for name in sorted(plugins.operator_names()):
            if NOT_MUTANTS.fullmatch(name) or plugins.get_operator(name).arguments():
                continue
            operator = plugins.get_operator(name)()
            positions = [begin for node in nodes for begin, _ in operator.mutation_positions(node)]
            for occurrence, begin in enumerate(positions):
                if not places.is_signature(begin):
                    yield Site(path, name, occurrence, places.name_of(begin[0]))


def mutant_at(site: Site) -> Mutant:
    """Make the mutant."""
    source = site.path.read_text()
    code = mutate_code(source, plugins.get_operator(site.operator)(), site.occurrence)
    changes = list(difflib.ndiff(source.splitlines(), code.splitlines()))
    was, now = (
        " ".join(line[1:].strip() for line in changes if line.startswith(sign)).strip()
        for sign in "-+"
    )
    return Mutant(code, site.where, was, now)


class _Places:
    """Which definition a line of a module belongs to, and what of it is never run."""

    def __init__(self, path: Path, folder: Path) -> None:
        source = path.read_text()
        module = ".".join(path.relative_to(folder / KERNEL).with_suffix("").parts)
        self._lines = source.splitlines()
        self._names: dict[int, str] = {}
        self._headers: list[_Span] = []
        self._defaults: list[_Span] = []
        pending: list[tuple[str, ast.stmt]] = [(module, node) for node in ast.parse(source).body]
        for prefix, node in pending:  # grows: outer definitions come before inner ones
            name, begin = prefix, node.lineno
            if isinstance(node, (ast.ClassDef, ast.FunctionDef)):
                name = f"{prefix}.{node.name}"
                begin = min([begin, *(each.lineno for each in node.decorator_list)])
                pending += [(name, inner) for inner in node.body]
            if isinstance(node, ast.FunctionDef):
                self._headers.append((_begin(node), _begin(node.body[0])))
                defaults = (*node.args.defaults, *node.args.kw_defaults)
                self._defaults += [(_begin(each), _end(each)) for each in defaults if each]
            for line in range(begin, (node.end_lineno or begin) + 1):
                self._names[line] = name

    def name_of(self, line: int) -> str:
        """Return the qualified name of the innermost definition around `line`."""
        return self._names[line]

    def named_lines(self) -> Iterator[tuple[str, str]]:
        """Yield each line that is in a definition, after the definition's name."""
        for number, name in self._names.items():
            yield name, self._lines[number - 1].strip()

    def is_signature(self, place: tuple[int, int]) -> bool:
        """Say whether an annotation or a mark of a function is there; mypy holds those."""
        return _is_in(place, self._headers) and not _is_in(place, self._defaults)


_Span = tuple[tuple[int, int], tuple[int, int]]


def _begin(node: ast.stmt | ast.expr) -> tuple[int, int]:
    return node.lineno, node.col_offset


def _end(node: ast.expr) -> tuple[int, int]:
    return node.end_lineno or node.lineno, node.end_col_offset or node.col_offset


def _is_in(place: tuple[int, int], spans: Sequence[_Span]) -> bool:
    return any(begin <= place < end for begin, end in spans)


def copied(folder: Path) -> Path:
    """Copy into `folder` what the tests of the kernel need."""
    for name in ("robotctl", "tests", "docs"):
        shutil.copytree(TREE / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(TREE / "pyproject.toml", folder)
    return folder


def run_tests(folder: Path, changed: str = "", *, cache: bool = False) -> int:
    """Run the tests of the kernel in a process of their own; return its exit code.

    Those that import the module `changed` run first.
    """
    files = sorted((folder / TESTS).glob("test_*.py"), key=lambda file: file.name in RUN_LAST)
    near = [
        file
        for file in files
        if file.name not in RUN_LAST and f"kernel.{changed} import" in file.read_text()
    ]
    fork = multiprocessing.get_context("fork")
    groups = [near, [file for file in files if file not in near]]
    process = fork.Process(target=_test, args=(folder, groups, cache), daemon=True)
    process.start()
    process.join(WALL_S)
    process.kill()
    process.join()
    code = process.exitcode
    return LIMIT_CODE if code is None or code < 0 else code


def _test(folder: Path, groups: Iterable[Sequence[Path]], cache: bool) -> None:
    signal.signal(signal.SIGXCPU, _end_tests)
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_S, CPU_S + 10))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    with (folder / "output").open("w") as output:
        os.dup2(output.fileno(), 1)
        os.dup2(output.fileno(), 2)
    os.chdir(folder)
    for variable in ("PYTHONPATH", "LD_LIBRARY_PATH", "AMENT_PREFIX_PATH"):
        os.environ.pop(variable, None)  # for a sourced ROS the tests would start this script again
    sys.dont_write_bytecode = not cache
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
    options = ["-x", "-q", "-n0", "-p", "no:cacheprovider", "--hypothesis-profile=mutation"]
    options += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]  # hypothesis is imported above
    code = 0
    for files in filter(None, groups):
        code = code or pytest.main([*options, *map(str, files)])
    # isort: split
    import robotctl

    assert Path(robotctl.__file__ or "").is_relative_to(folder), robotctl.__file__
    os._exit(code)


def _end_tests(*_signal: object) -> None:
    pytest.exit("too much CPU time", LIMIT_CODE)


def exit_code_with(path: Path, code: str, folder: Path) -> int:
    """Run the tests of the kernel with `code` at `path`; return their exit code."""
    original = path.read_text()
    path.write_text(code)
    try:
        return run_tests(folder, path.stem)
    finally:
        path.write_text(original)


def equivalents() -> dict[Key, str]:
    """Return the reasons of `equivalent.toml` by the mutants' keys."""
    groups = tomllib.loads((Path(__file__).parent / "equivalent.toml").read_text())["group"]
    return {tuple(key): group["reason"] for group in groups for key in group["mutants"]}


def stale_entries(listed: Iterable[Key], every: Sequence[Site], folder: Path) -> list[Key]:
    """Return the entries whose definition is gone, or does not hold the line any more."""
    lines = {
        each
        for path in {site.path for site in every}
        for each in _Places(path, folder).named_lines()
    }
    return [key for key in listed if key[:2] not in lines]


def main() -> int:
    """Draw, run and report."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, help="how many mutants to draw; default: all")
    parser.add_argument("--seed", type=int, default=1, help="of the draw; default: 1")
    parser.add_argument("--part", type=_part, default=slice(None), help="such as 3/16")
    parser.add_argument("--only", default="", help="a name such as drive. or drive.Drive.advance")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="robotctl-mutation-") as name:
        folder = copied(Path(name).resolve())
        every, listed = list(sites(folder)), equivalents()
        if stale := stale_entries(listed, every, folder):
            print("equivalent.toml lists what is not in the code:", *stale, sep="\n")
            return 1
        drawn = [site for site in every if site.where.startswith(options.only)]
        print(f"{options.count or 'all'} of {len(drawn)} mutants, seed {options.seed}")
        random.Random(options.seed).shuffle(drawn)
        if run_tests(folder, cache=True) != 0:
            print((folder / "output").read_text(), "the tests fail without a mutant", sep="\n")
            return 1
        shutil.rmtree(folder / KERNEL / "__pycache__")  # may be taken for that of a mutant
        return report(drawn[: options.count][options.part], listed, folder)


def _part(text: str) -> slice:
    """Return which mutants the part `text` has: 3/16 is every 16th from the third on."""
    number, parts = map(int, text.split("/"))
    if not 1 <= number <= parts:
        raise ValueError(text)
    return slice(number - 1, None, parts)


def report(drawn: Sequence[Site], listed: Mapping[Key, str], folder: Path) -> int:
    """Run the mutants, print those that survive and the figures; return the exit code."""
    counts: Counter[str] = Counter()
    wrong = 0
    begin = time.monotonic()
    for number, site in enumerate(drawn, 1):
        mutant = mutant_at(site)
        code = exit_code_with(site.path, mutant.code, folder)
        survived, is_listed = code == 0, mutant.key in listed
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


if __name__ == "__main__":
    sys.exit(main())
