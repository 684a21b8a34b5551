"""The settings of the site: sphinx-build -W docs build/site."""

from __future__ import annotations

import re
from typing import Any

project = html_title = "robotctl"
extensions = ["myst_parser"]
html_theme = "furo"
templates_path = ["_templates"]
exclude_patterns = ["*.py"]
myst_heading_anchors = 4
suppress_warnings = ["misc.highlighting_failure"]  # Mermaid stays text: it needs a foreign script
html_copy_source = html_show_sourcelink = html_show_sphinx = html_show_copyright = False

_TO_SOURCE_TREE = re.compile(r"\[([^\]]+)\]\((?:\.\./)+([^)]+)\)")
_TO_ELSEWHERE = re.compile(r"(?<!!)\[([^\]]+)\]\((https?://[^)]+)\)")


def setup(app: Any) -> None:
    """Take part in the building."""
    app.connect("source-read", _name_what_the_site_does_not_hold)


def _name_what_the_site_does_not_hold(app: Any, page: str, source: list[str]) -> None:
    """Name files outside of docs/ and addresses instead of linking to them."""
    text = _TO_SOURCE_TREE.sub(r"\1 (`\2` in the source tree)", source[0])
    source[0] = _TO_ELSEWHERE.sub(r"\1 (`\2`)", text)
