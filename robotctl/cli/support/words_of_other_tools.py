"""The words that people bring from ros2 and other tools, with the command that does it here."""

from __future__ import annotations

from robotctl.kernel.patterns import PatternKind

PATTERN_WORDS = (*(kind.value for kind in PatternKind), "path", "velocity")
"""What `robotctl drive` takes."""

OTHER_WORDS = {
    "list": "`robotctl ps` lists robots, `robotctl recordings` recordings, "
    "`robotctl topic list` topics",
    "kill": "`robotctl estop` stops the robot at once, `robotctl stop` ends the daemon",
    "run": "`robotctl start` starts the daemon, `robotctl drive` drives",
    "launch": "`robotctl start` starts the daemon",
    "bag": "`robotctl start` records everything; see `robotctl recordings`, `robotctl replay`",
    "play": "`robotctl replay FILE` plays a recording to ROS",
    "csv": "`robotctl export FILE --topic TOPIC` writes a topic as CSV",
    "rm": "`robotctl recordings rm NAME` removes a recording",
    "delete": "`robotctl recordings rm NAME` removes a recording",
    "ls": "`robotctl recordings` lists recordings, `robotctl ps` robots",
    "echo": "`robotctl topic echo TOPIC` prints messages",
    "hz": "`robotctl topic hz TOPIC` measures the rate",
    "call": "`robotctl service call NAME` calls a service",
    "move": "`robotctl drive` drives",
    "go": "`robotctl drive` drives",
    "forward": "`robotctl drive line` drives straight ahead",
    "halt": "`robotctl set-mode idle` ramps the robot down, `robotctl estop` stops it at once",
    "pause": "`robotctl set-mode idle` ramps the robot down",
    "shutdown": "`robotctl stop` ends the daemon",
    "restart": "`robotctl stop`, then `robotctl start`",
    "mode": "`robotctl status` shows the mode, `robotctl set-mode` asks for one",
    "log": "`robotctl logs` prints the log of the daemon",
    "params": "`robotctl param list` lists the parameters",
    "check": "`robotctl replay FILE --check` checks a recording",
    "figure8": "`robotctl drive figure-eight`",
    **{word: f"`robotctl drive {word}`" for word in PATTERN_WORDS},
}
"""What each word is called here."""
