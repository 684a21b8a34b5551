"""The documents say what the code does."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

from robotctl.base import errors
from robotctl.base.errors import ConfigError
from robotctl.cli.registry import COMMANDS
from robotctl.config import Config, flat, with_setting
from robotctl.kernel.modes import Mode
from robotctl.kernel.safety import RULES

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_command_that_a_page_names_exists(page: Path) -> None:
    blocks = re.split(r"^```", page.read_text(), flags=re.MULTILINE)
    prose, code = "".join(blocks[::2]), "".join(blocks[1::2])
    pieces = [*re.findall(r"`([^`]+)`", prose), *code.splitlines()]
    named = set(
        re.findall(r"^\s*(?:uv run )?robotctl ([a-z][a-z-]*)", "\n".join(pieces), re.MULTILINE)
    )
    assert named <= set(COMMANDS), named - set(COMMANDS)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_page_that_a_page_links_to_exists(page: Path) -> None:
    links = re.findall(r"\]\((?!http)([^)#]+)\)", page.read_text())
    missing = [link for link in links if not (page.parent / link).exists()]
    assert not missing


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_file_that_a_page_names_exists(page: Path) -> None:
    """A path is meant from the root, from robotctl/, or from the page's own folder."""
    named = re.findall(r"`([a-z_]+/[a-z_/]+\.(?:py|msg|toml|xml|yml))\b", page.read_text())
    places = [ROOT, ROOT / "robotctl", page.parent]
    assert [name for name in named if not any((place / name).exists() for place in places)] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_test_that_a_page_names_exists(page: Path) -> None:
    named = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", page.read_text())
    missing = [test for file, test in named if f"def {test}(" not in (ROOT / file).read_text()]
    assert missing == []


def test_the_readme_names_every_command() -> None:
    readme = (ROOT / "README.md").read_text()
    assert [name for name in COMMANDS if f"robotctl {name}" not in readme] == []


def test_every_module_of_commands_is_a_command() -> None:
    modules = (ROOT / "robotctl" / "cli" / "commands").glob("[a-z]*/[a-z]*")
    assert {path.stem.replace("_", "-") for path in modules} == set(COMMANDS)


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
