"""The names in header and metadata by which robotctl recognizes its own files and records."""

from __future__ import annotations

import platform

import robotctl

PROFILE = "ros2"
OWN_LIBRARY = "robotctl "
"""The beginning of the library name in the header of each file that robotctl writes."""

LIBRARY = OWN_LIBRARY + robotctl.__version__
INFO_RECORD = "robotctl"
"""The robot, and what made the recording; written when a file begins."""

PARAMETER_PREFIX = "parameter."
"""The beginning of the keys in INFO_RECORD that are parameters."""

SOFTWARE_RECORD = "robotctl.software"
"""The content hashes of the modules that decide and command; written when a file begins."""

SHADOW_RECORD = "robotctl.shadow"
"""In files of 0.1 and 0.2: the parameters of a second kernel that decided and drove nothing."""

FOXGLOVE_RECORD = "foxglove"
"""The name of the device, where Foxglove looks for it; written when a file begins."""

EVENT_RECORD = "robotctl.event"
"""One event of the recording, written as it happens: see `recorded_events`."""

LEDGER_RECORD = "robotctl.ledger"
"""The loss ledger since the recording began, one JSON object per topic. It is the last record of a
finished file. Its queued messages arrived while the file was being finished."""

CLIP_RECORD = "robotctl.clip"
"""In a clip: the recording it was cut from, the event, and what is missing."""

RECOVERY_RECORD = "robotctl.recovery"
"""In a recovered file: the file it was made from, and what is lost."""

CONVERSION_RECORD = "robotctl.conversion"
"""In a converted file: the files it was made from, and what is missing."""

MADE_BY = f"Python {platform.python_version()}, {' '.join(platform.libc_ver())}".rstrip()
"""Python and libc: the last bit of sin and cos depends on them."""
