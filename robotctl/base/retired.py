"""Removed features of earlier versions, each with advice for its users.

A command or option is refused, a configuration key causes a warning. An entry is kept for one
version, or forever for journals.
"""

from __future__ import annotations

from collections.abc import Mapping

COMMANDS: Mapping[str, str] = {}
"""Removed commands, as typed after `robotctl`, with their replacements."""

OPTIONS: Mapping[tuple[str, str], str] = {
    ("replay", "--force"): "--original-names publishes where a daemon runs, and --force-types "
    "plays types that have changed",
    ("replay", "--view"): "use: --draw (in the terminal), or open the .mcap file in Foxglove",
    ("replay", "--view-only"): "use: --draw-only (in the terminal)",
    ("view", "--at"): "Foxglove and Lichtblick open the .mcap file themselves",
    ("report", "--compare"): "use: robotctl gate RECORDINGS --baseline FILE",
}
"""Removed options as (command, option), with their replacements."""

ARGUMENTS: Mapping[str, str] = {
    "view": "Foxglove and Lichtblick open the .mcap file themselves; or use: robotctl report FILE",
    "doctor": "docs/tutorial.md has the usual mistakes of a first ROS 2 package, with their cures",
}
"""Commands that no longer accept an argument, with the argument's replacement."""

CONFIG_KEYS: Mapping[str, str] = {
    "shadow": "compare other parameters on recordings: robotctl replay FILE --what-if KEY=VALUE",
    "standalone": "MOVING needs a robot; robotctl start --sim simulates one",
}
"""Removed keys of configuration files and launch arguments, with their replacements."""

JOURNAL_FIELDS: Mapping[str, object] = {"Snapshot.params.standalone": False}
"""Removed fields of a journal's snapshots, as `Snapshot.path`, each with the default to ignore."""

CAUSES: Mapping[str, str] = {
    "gate lost": "the daemon commands the robot itself, without a gate in another process",
}
"""Removed causes that old journals may contain, with the reason for the removal."""
