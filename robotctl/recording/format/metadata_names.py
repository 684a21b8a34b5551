"""What marks a file as ours, and the names of the metadata records in it."""

from __future__ import annotations

import platform

import robotctl

PROFILE = "ros2"
OWN_LIBRARY = "robotctl "
"""What the library in the header of a file of ours begins with."""

LIBRARY = OWN_LIBRARY + robotctl.__version__
INFO_RECORD = "robotctl"
"""What the daemon says about itself and the robot when a file begins."""

EVENT_RECORD = "robotctl.event"
"""Something to look for in the recording, written as it happens: see `events`."""

LEDGER_RECORD = "robotctl.ledger"
"""The loss ledger since the recording began, one JSON object per topic; the last thing written:
then the file is finished. Queued is what came while the file was being finished."""

CLIP_RECORD = "robotctl.clip"
"""In a file made by `clip`: out of which recording, around what, and what of it is missing."""

RECOVERY_RECORD = "robotctl.recovery"
"""In a file made by `recover`: from which file, and what is lost."""

MADE_BY = f"Python {platform.python_version()}, {' '.join(platform.libc_ver())}".rstrip()
"""Where floats come from: the last bit of sin and cos belongs to Python and libc."""
