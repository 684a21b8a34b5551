"""What earlier versions had and this one has not, with what a user does instead.

A retired command or option is refused with that sentence, a retired key of a configuration gives
one warning and is ignored, and a retired field of a journal at its default changes no verdict.
Each row stays for one version, but those of journals, which are read for as long as there are
recordings.
"""

from __future__ import annotations

from collections.abc import Mapping

COMMANDS: Mapping[str, str] = {}
"""Commands, as typed after `robotctl`, with what replaces them."""

OPTIONS: Mapping[tuple[str, str], str] = {
    ("replay", "--force"): "--original-names publishes where a daemon runs, and --force-types "
    "plays types that have changed",
    ("replay", "--view"): "use: --draw (in the terminal), or open the .mcap file in Foxglove",
    ("replay", "--view-only"): "use: --draw-only (in the terminal)",
    ("view", "--at"): "Foxglove and Lichtblick open the .mcap file themselves",
    ("report", "--compare"): "use: robotctl gate RECORDINGS --baseline FILE",
}
"""Options by command (`replay`, `boot install`), with what replaces them."""

ARGUMENTS: Mapping[str, str] = {
    "view": "Foxglove and Lichtblick open the .mcap file themselves; or use: robotctl report FILE",
    "doctor": "docs/tutorial.md has the usual mistakes of a first ROS 2 package, with their cures",
}
"""Commands that had an argument, with what replaces it."""

CONFIG_KEYS: Mapping[str, str] = {
    "shadow": "compare other parameters on recordings: robotctl replay FILE --what-if KEY=VALUE",
    "standalone": "MOVING needs a robot; robotctl start --sim simulates one",
}
"""Dotted keys of configuration files and launch arguments, with what replaces them."""

JOURNAL_FIELDS: Mapping[str, object] = {"Snapshot.params.standalone": False}
"""Fields of a journal's snapshots as `Snapshot.path`, with the default that is ignored."""

CAUSES: Mapping[str, str] = {
    "gate lost": "the daemon commands the robot itself, without a gate in another process",
}
"""Causes that journals name, with why there is no such cause any more."""
