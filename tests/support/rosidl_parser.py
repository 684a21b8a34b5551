"""Imports the old parser of the interface generators before warnings are errors.

Where the generators are installed, rclpy imports it with the first type support.
"""

from __future__ import annotations

import warnings

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import rosidl_generator_py  # noqa: F401
