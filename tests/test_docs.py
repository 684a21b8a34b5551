"""The documents say what the code does.
Every command line of the pages parses, and every link within them leads somewhere.
"""

from __future__ import annotations

import re
import runpy
import shlex
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages
from typing import Any

import pytest
import typer
from PIL import Image

from robotctl.base import errors
from robotctl.base.errors import ConfigError
from robotctl.cli import registry
from robotctl.cli.app import behind_the_command
from robotctl.cli.registry import COMMANDS
from robotctl.config import Config, flat, with_setting
from robotctl.kernel.modes import Mode
from robotctl.kernel.safety import RULES
from robotctl.show.figure import path_figure
from robotctl.show.png import write_path_png
from tests.support.cases import for_each

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]


@for_each("page", PAGES)
def test_every_command_that_a_page_names_exists(page: Path) -> None:
    blocks = re.split(r"^```", page.read_text(), flags=re.MULTILINE)
    prose, code = "".join(blocks[::2]), "".join(blocks[1::2])
    pieces = [*re.findall(r"`([^`]+)`", prose), *code.splitlines()]
    named = set(
        re.findall(r"^\s*(?:uv run )?robotctl ([a-z][a-z-]*)", "\n".join(pieces), re.MULTILINE)
    )
    assert named <= set(COMMANDS), named - set(COMMANDS)


@for_each("page", PAGES)
def test_every_page_that_a_page_links_to_exists(page: Path) -> None:
    links = re.findall(r"\]\((?!http)([^)#]+)\)", page.read_text())
    missing = [link for link in links if not (page.parent / link).exists()]
    assert not missing


@for_each("page", PAGES)
def test_every_file_that_a_page_names_exists(page: Path) -> None:
    """A path is meant from the root, from robotctl/, or from the page's own folder."""
    named = re.findall(r"`([a-z_]+/[a-z_/]+\.(?:py|msg|toml|xml|yml))\b", page.read_text())
    places = [ROOT, ROOT / "robotctl", page.parent]
    assert [name for name in named if not any((place / name).exists() for place in places)] == []


@for_each("page", PAGES)
def test_every_test_that_a_page_names_exists(page: Path) -> None:
    named = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", page.read_text())
    missing = [test for file, test in named if f"def {test}(" not in (ROOT / file).read_text()]
    assert missing == []


def test_the_readme_names_every_command() -> None:
    readme = (ROOT / "README.md").read_text()
    assert [name for name in COMMANDS if f"robotctl {name}" not in readme] == []


def test_every_command_of_a_module_is_in_the_help() -> None:
    modules = walk_packages([f"{ROOT}/robotctl/cli/commands"], "robotctl.cli.commands.")
    apps = [getattr(import_module(each.name), "app", None) for each in modules]
    declared = [name for app in apps if app for name in typer.main.get_group(app).commands]
    assert sorted(declared) == sorted(COMMANDS)


def test_every_node_is_documented() -> None:
    page = (ROOT / "docs" / "ros.md").read_text()
    documented = re.findall(r"^\| `/(\w+)` \|", page, re.MULTILINE)
    ros = ROOT / "robotctl" / "ros"
    code = "\n".join(path.read_text() for path in [ros / "session.py", *ros.glob("nodes/*.py")])
    named = r'(?:\.node(?:\(|_of\(\w+, )|^(?:RECORDER_NODE|NODE_NAME) = )"(\w+)"'
    assert sorted(re.findall(named, code, re.MULTILINE)) == sorted(documented)


def test_the_fields_of_every_interface_are_documented() -> None:
    page = (ROOT / "docs" / "ros.md").read_text()
    for path in (each for kind in ("msg", "srv", "action") for each in ROOT.glob(f"{kind}/*.*")):
        lines = (line.partition("#")[0].strip() for line in path.read_text().splitlines())
        fields = [line for line in lines if line]
        _, _, told = page.partition(f"# robot_controller/{path.parent.name}/{path.stem}\n")
        shown = (line.partition("#")[0].strip() for line in told.partition("```")[0].splitlines())
        assert [line for line in shown if line][: len(fields)] == fields, path.name


def test_the_table_of_parameters_is_made_from_their_declarations() -> None:
    made = runpy.run_path(str(ROOT / "docs" / "parameter_table.py"))["table"]()
    page = (ROOT / "docs" / "ros.md").read_text()
    assert f"\n{made}\n" in page, "paste: python docs/parameter_table.py"


def test_the_parameters_are_documented_with_what_is_allowed() -> None:
    table = (ROOT / "docs" / "ros.md").read_text()
    documented = dict(re.findall(r"^\| `([\w.]+)` \| \S* \| (.*) \|", table, re.MULTILINE))
    for key in flat(Config()):
        with pytest.raises(ConfigError) as refused:
            with_setting(Config(), key, object())
        allowed = refused.value.cure.removeprefix("use ")
        number, _, limits = allowed.partition("a number from ")
        if not number:
            assert documented[key].startswith(limits), key
        elif re.fullmatch(r"[\w-]+(, [\w-]+)+", allowed):
            assert [each for each in allowed.split(", ") if each not in documented[key]] == [], key


def test_the_readme_tells_the_exit_codes_in_use() -> None:
    readme = (ROOT / "README.md").read_text()
    told = {int(code) for code in re.findall(r"\b(\d+) [a-z]", readme.split("exit code:")[1][:200])}
    used = {
        kind.exit_code
        for kind in vars(errors).values()
        if isinstance(kind, type) and issubclass(kind, errors.RobotctlError)
    }
    assert told == used | {0, errors.INTERRUPTED_EXIT_CODE}


def test_the_safety_page_lists_every_rule_that_ends_a_motion_in_its_order() -> None:
    page = (ROOT / "docs" / "safety.md").read_text()
    table = page.split("## What ends a motion by itself")[1].split("\n## ")[0]
    rows = re.findall(
        r"^\| ([a-z ]+) \| [^|]+ \| ([A-Z_]+)(, also from IDLE)? \|", table, re.MULTILINE
    )
    told = [(cause, action, bool(idle)) for cause, action, idle in rows]
    assert told == [
        (rule.cause.value, rule.action.name, Mode.IDLE in rule.raised_in)
        for rule in RULES
        if rule.raised_in
    ]


def test_each_promise_of_the_safety_page_names_tests_that_exist() -> None:
    page = (ROOT / "docs" / "safety.md").read_text()
    promises = page.split("## What it promises")[1].split("\n## ")[0]
    table = page.split("## The test of each promise")[1]
    rows = dict(re.findall(r"^\| ([^|`]+) \| (`.+`) \|$", table, re.MULTILINE))
    promised = re.findall(r"^- \*\*([^*]+)\.\*\*", promises, re.MULTILINE)
    assert len(promised) == promises.count("\n- ")
    assert list(rows) == promised
    for test in re.findall(r"`([^`]+)`", "".join(rows.values())):
        file, _, name = test.partition("::")
        assert f"def {name}(" in (ROOT / file).read_text(), test


_CALL = re.compile(r"\s*(?:\$ )?(?:[A-Z_]+=\S+ )*(?:uv run )?robotctl(?= |$)(.*)")
_SHELL = set("|&;<>()")


def words_of(line: str) -> list[str]:
    """Return the words behind `robotctl`, up to a comment or what is the shell's."""
    lexer = shlex.shlex(line, posix=True, punctuation_chars=True)
    lexer.whitespace_split = True
    words: list[str] = []
    for word in lexer:
        if set(word) <= _SHELL:
            break
        words.append(word)
    return words[: words.index("--ros-args")] if "--ros-args" in words else words


def parse(words: list[str]) -> None:
    """Parse a command line as robotctl does, without running it.

    Raises:
        Exception: It has an unknown command or option, or lacks an argument.
    """
    command: Any = typer.main.get_command(registry.app)
    context = command.make_context("robotctl", [], resilient_parsing=True)
    rest = behind_the_command(words) if words[0].startswith("--") else words
    while hasattr(command, "list_commands") and rest and not rest[0].startswith("-"):
        name, *rest = rest
        inner = command.get_command(context, name)
        if inner is None:
            raise ValueError(f"no command {name}")
        command = inner
    command.make_context("robotctl", rest)


def command_lines(page: Path) -> Iterator[str]:
    """Yield what follows `robotctl` in each line of a page's code."""
    blocks = re.split(r"^```", page.read_text(), flags=re.MULTILINE)[1::2]
    code = "\n".join(block.partition("\n")[2] for block in blocks).replace("\\\n", " ")
    for line in code.splitlines():
        if match := _CALL.match(line):
            yield match[1]


@for_each("page", PAGES)
def test_every_command_line_of_a_page_can_be_typed(page: Path) -> None:
    wrong = []
    for line in command_lines(page):
        try:
            parse(words_of(line) or ["--help"])
        except typer.Exit:  # --help
            continue
        except Exception as error:  # noqa: BLE001 (they have no common public class)
            wrong.append(f"robotctl{line}: {getattr(error, 'message', error)}")
    assert wrong == []


@for_each(
    "line", [" status --bogus", " statuss", " topic echoo /odom", " export last", " recordings rm"]
)
def test_a_line_that_cannot_be_typed_is_found(line: str) -> None:
    with pytest.raises(Exception, match=r"(?i)no such option|no command|missing"):
        parse(words_of(line))


def anchors_of(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as GitHub makes them."""
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", each.lower()).replace(" ", "-") for each in headings}


@for_each("page", PAGES)
def test_every_anchor_that_a_page_links_to_exists(page: Path) -> None:
    links = re.findall(r"\]\((?!http)([^)#]*)#([^)]+)\)", page.read_text())
    dead = [
        f"{file}#{anchor}"
        for file, anchor in links
        if anchor not in anchors_of((page.parent / file) if file else page)
    ]
    assert dead == []


def test_the_site_has_every_page() -> None:
    listed = set((ROOT / "docs" / "index.md").read_text().splitlines())
    assert {path.stem for path in (ROOT / "docs").glob("*.md")} - {"index"} <= listed


def test_the_picture_of_the_readme_is_one_that_the_product_draws(tmp_path: Path) -> None:
    """`python docs/pictures.py` makes it."""
    write_path_png(
        tmp_path / "drawn.png", path_figure([(0, 0), (1, 0)], [(0, 0), (1, 0.1)], "demo")
    )
    pictures = [Image.open(path) for path in (tmp_path / "drawn.png", ROOT / "docs" / "demo.png")]
    names = [picture.crop((660, 750, 720, 775)).getcolors() for picture in pictures]  # "x [m]"
    assert pictures[0].size == pictures[1].size
    assert names[0] == names[1]
