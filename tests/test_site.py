"""The site is built from docs/ without a warning, and needs nothing from elsewhere."""

from __future__ import annotations

import re
import subprocess
import sys
from html.parser import HTMLParser
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

ROOT = Path(__file__).parents[1]

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not (find_spec("furo") and find_spec("myst_parser")),
        reason="the group docs is not installed: pip install --group docs",
    ),
]

NAMED = re.compile(
    r"https?://(www\.w3\.org/|snowballstem\.org/|developer\.mozilla\.org/en-US/docs/Web/JavaScript/)"
)
"""Names of XML, and addresses in comments of Sphinx's scripts: none is ever fetched."""


class Links(HTMLParser):
    """Collects what a page loads or links to, and its anchors."""

    def __init__(self) -> None:
        super().__init__()
        self.links: set[str] = set()
        self.anchors: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name in ("src", "href", "action", "data", "poster") and value:
                self.links.add(value)
            if name == "id" and value:
                self.anchors.add(value)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the built site."""
    target = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-W", "-q", "-d", f"{target}-cache"]
    ran = subprocess.run(
        [*command, str(ROOT / "docs"), str(target)], capture_output=True, text=True
    )
    assert (ran.returncode, ran.stderr) == (0, "")
    return target


def test_nothing_of_the_site_is_loaded_from_elsewhere_or_leads_there(site: Path) -> None:
    """A page may name an address in its text; no attribute, style or script may hold one."""
    found: set[str] = set()
    for path in site.rglob("*"):
        if path.suffix == ".html":
            page = Links()
            page.feed(path.read_text())
            urls = [link for link in page.links if urlsplit(link).netloc]
            urls += re.findall(r"url\([^)]*//[^)]*\)", path.read_text())
        elif path.suffix in (".js", ".css", ".svg"):
            urls = re.findall(r"(?:https?:|[\"'(])//[\w-]+\.[\w./-]+", path.read_text())
        else:
            continue
        found |= {f"{path.name}: {url}" for url in urls if not NAMED.match(url)}
    assert found == set()


def test_each_link_of_the_site_leads_to_a_file_and_an_anchor_of_it(site: Path) -> None:
    pages = {}
    for path in site.rglob("*.html"):
        pages[path] = Links()
        pages[path].feed(path.read_text())
    dead = []
    for path, page in pages.items():
        for link in page.links:
            if link.startswith("data:"):
                continue
            parts = urlsplit(link)
            target = path.parent / unquote(parts.path) if parts.path else path
            known = pages.get(target.resolve())
            if not target.is_file() or (
                parts.fragment and known and unquote(parts.fragment) not in known.anchors
            ):
                dead.append(f"{path.name}: {link}")
    assert dead == []
    assert {"index.html", "tutorial.html", "library.html"} <= {path.name for path in pages}
