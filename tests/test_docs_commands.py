"""Every command line of the pages parses, and every link within them leads somewhere."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from PIL import Image

from robotctl.cli import registry
from robotctl.cli.app import behind_the_command
from robotctl.show.figure import path_figure
from robotctl.show.png import write_path_png

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]

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


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
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


@pytest.mark.parametrize(
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


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
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
