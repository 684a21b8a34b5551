"""Imports what the interface generators bring before warnings count as errors."""

from __future__ import annotations

import warnings

with warnings.catch_warnings():
    # Where the interface generators are installed, rclpy imports an old parser with them.
    warnings.simplefilter("ignore")
    import rosidl_generator_py  # noqa: F401
