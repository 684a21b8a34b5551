"""The mutants of `robotctl/kernel`: where they can be made, and which are equivalent."""

from __future__ import annotations

import ast
import difflib
import re
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from cosmic_ray import plugins
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code

KERNEL = Path("robotctl/kernel")

NOT_MUTANTS = re.compile(
    # TypeError on floats, whatever the tests are: these would flatter the figure.
    r"core/ReplaceBinaryOperator_(\w+_(RShift|LShift|BitOr|BitAnd|BitXor)|BitOr_\w+)"
    # Members of an enum and classes are compared with `is`: equal is the same, order a TypeError.
    r"|core/ReplaceComparisonOperator_(Is|IsNot)_(?!Is)\w+"
    # `is` between numbers depends on the interpreter.
    r"|core/ReplaceComparisonOperator_(?!Is)[A-Za-z]+_(Is|IsNot)"
)
"""Operators of cosmic-ray that say nothing about the tests."""

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
    """The code of the module at `path` with one change: in `where`, `was` became `now`."""

    path: Path
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
                is_unpacking = "BinaryOperator" in name and not places.has_operand_before(begin)
                if not places.is_signature(begin) and not is_unpacking:
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
    return Mutant(site.path, code, site.where, was, now)


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

    def has_operand_before(self, place: tuple[int, int]) -> bool:
        """Say whether the operator there has two operands: `**` in `f(**values)` has one."""
        line, column = place
        return self._lines[line - 1][:column].rstrip()[-1:] not in ("", *"([{,=:")

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
