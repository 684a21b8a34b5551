"""Imports rosidl_generator_py, whose old parser causes warnings, while warnings are no errors.

Where it is installed, rclpy imports it with the first type support.
"""

from __future__ import annotations

import warnings

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import rosidl_generator_py  # noqa: F401
