"""Parses an HTML page that must work without a network, and lists its errors."""

from __future__ import annotations

from collections import Counter
from html.parser import HTMLParser

WITHOUT_END = {"meta", "input", "br", "link", "img"}
REFERENCES = {"src", "href", "srcset", "action", "data", "poster", "xlink:href"}


class HtmlPage(HTMLParser):
    """The elements, ids, references and texts of a page; `wrong` has a sentence for each error."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: Counter[str] = Counter()
        self.ids: Counter[str] = Counter()
        self.references: list[str] = []
        self.attributes: set[str] = set()
        self.wrong: list[str] = []
        self.sections: dict[str, str] = {}
        self._open: list[str] = []
        self._section = ""
        self.feed(text)
        self.close()
        self.wrong += [f"{name} is not closed" for name in self._open]
        self.wrong += [f"the id {name} stands {n} times" for name, n in self.ids.items() if n > 1]
        inner = {each[1:] for each in self.references if each.startswith("#")}
        self.wrong += [f"no element has the id {name}" for name in inner - set(self.ids)]
        self.wrong += [f"refers to {each}" for each in self.references if each[:1] != "#"]

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Record the beginning of an element."""
        self.tags[tag] += 1
        for name, value in attrs:
            self.attributes.add(name)
            if name == "id":
                self.ids[value or ""] += 1
            if name in REFERENCES:
                self.references.append(value or "")
        if tag in ("section", "header"):
            self._section = dict(attrs).get("id") or tag
        if tag not in WITHOUT_END:
            self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        """Check the end of an element."""
        if not self._open or self._open.pop() != tag:
            self.wrong.append(f"</{tag}> closes another element")

    def handle_data(self, data: str) -> None:
        """Add a text to its section."""
        self.sections[self._section] = self.sections.get(self._section, "") + f" {data}"
