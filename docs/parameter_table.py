"""Prints the table of parameters in docs/ros.md, from their declarations.

python docs/parameter_table.py
"""

from __future__ import annotations

from robotctl.config import declarations


def table() -> str:
    """Return a row for each key: default, allowed values, when it changes, what it is."""
    rows = ["| key | default | allowed | changes | |", "|---|---|---|---|---|"]
    rows += [
        f"| `{key}` | {each.default} | {each.allowed} | {each.change.value} | {each.about} |"
        for key, each in declarations().items()
    ]
    return "\n".join(rows)


if __name__ == "__main__":
    print(table())
