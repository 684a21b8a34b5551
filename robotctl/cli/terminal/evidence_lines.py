"""The report of `robotctl evidence` as text."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

from robotctl.cli.terminal.text import moment, printable, row, short_path, size

MOST_SHOWN: Final = 50
"""Of each list, the last ones, and of sentences on the journal the first; `--json` has all."""

_INDENT = "  "


def evidence_lines(answer: Mapping[str, Any]) -> Iterator[str]:
    """Yield the report, from the object of `--json`."""
    journal = answer["journal"]
    since = "" if answer["since_ns"] is None else f" since {moment(answer['since_ns'])}"
    yield f"robot {answer['robot']}{since}"
    yield from _field("journal", f"{journal['entries']} entries in {short_path(journal['folder'])}")
    if journal["first_ns"] is not None:
        yield from _field("from", moment(journal["first_ns"]))
        yield from _field("to", moment(journal["last_ns"]))
    yield from _field("appended to", "NO" if journal["broken"] else "and never changed")
    for sentences in (journal["broken"], journal["notes"]):
        for sentence in sentences[:MOST_SHOWN]:
            yield from _field("", sentence)
        if len(sentences) > MOST_SHOWN:
            yield from _field("", f"and {len(sentences) - MOST_SHOWN} more: --json")
    yield from _software(answer["software"])
    yield from _section("changes of software", answer["software_changes"], _changed)
    yield from _section("changes of settings", answer["configuration_changes"], _changed)
    yield from _section("daemons", answer["daemons"], _daemon)
    yield from _section("stops", answer["stops"], _mode)
    yield from _section("releases", answer["releases"], _mode)
    yield from _section("interventions", answer["interventions"], _request)
    yield from _section("refused", answer["refusals"], _request)
    yield from _section("not written one by one", answer["unwritten"], _unwritten)
    yield from _section("recordings that retention removed", answer["removed"], _removed)
    yield from _recordings(answer["recordings"])
    for name, label in (("wrong", "wrong"), ("notes", "note")):
        for sentence in (answer["verify"] or {}).get(name, ()):
            yield from row(_INDENT, f"{label}: {sentence}")


def _software(software: Mapping[str, Any]) -> Iterator[str]:
    if software:
        yield ""
        yield "software of the last start"
    for name, value in software.items():
        yield from _field(name, value)


def _section(
    title: str, items: Sequence[Mapping[str, Any]], text: Callable[[Mapping[str, Any]], str]
) -> Iterator[str]:
    yield ""
    if not items:
        yield f"{title}: none"
        return
    earlier = len(items) - MOST_SHOWN
    yield f"{title}: {len(items)}" + (f" ({earlier} earlier ones: --json)" if earlier > 0 else "")
    for item in items[-MOST_SHOWN:]:
        yield from row(f"{_INDENT}{moment(item['time_ns'])}  ", text(item))


def _changed(item: Mapping[str, Any]) -> str:
    by = f", by {item['by']}" if item.get("by") else ""
    if item["first"]:
        return f"noted for the first time{by}"
    changes = (f"{key}: {old} -> {new}" for key, (old, new) in item["changed"].items())
    return f"{'; '.join(changes)}{by}"


def _daemon(item: Mapping[str, Any]) -> str:
    until = "" if item["end_ns"] is None else f" until {moment(item['end_ns'])}"
    kind = "observer" if item.get("observe") else "driver"
    version = item.get("version", "")
    return f"{kind} {version} by {item.get('by', 'an unknown user')}{until}: {item['ended']}"


def _mode(item: Mapping[str, Any]) -> str:
    latch = " (latched)" if item.get("latched") else ""
    return f"{item.get('from')} -> {item.get('to')}{latch}: {item.get('reason', '')}"


def _request(item: Mapping[str, Any]) -> str:
    return f"{item.get('asked')} by {item.get('by')}: {item.get('answer')}"


def _unwritten(item: Mapping[str, Any]) -> str:
    counts = ", ".join(f"{count} {kind}" for kind, count in item.get("counts", {}).items())
    return f"{counts}, since {moment(item.get('first_ns', 0))}: the recordings hold them"


def _removed(item: Mapping[str, Any]) -> str:
    return str(item.get("file", ""))


def _recordings(recordings: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    yield ""
    yield "recordings" if recordings else "recordings: none"
    for item in recordings:
        verdicts = [f"{name} {item[name]}" for name in ("verify", "check") if item[name]]
        told = ", ".join([item["state"], *verdicts])
        if "size_bytes" in item:
            told = f"{size(item['size_bytes'])}, {told}"
        yield from row(_INDENT, f"{short_path(item['path'])}: {told}")
        for label in ("wrong", "unproved"):
            for sentence in item[label]:
                yield from row(_INDENT * 2, f"{label}: {sentence}")


def _field(name: str, value: object) -> Iterator[str]:
    yield from row(f"{_INDENT}{printable(name):18} ", value)
