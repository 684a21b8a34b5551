"""What rclpy raises for a wrong command line."""

from __future__ import annotations

from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy

BAD_ARGUMENTS = (
    *(_rclpy.RCLError, _rclpy.RCLInvalidROSArgsError, _rclpy.UnknownROSArgsError),
    *(NameValidationException, ParameterException),
)
"""What rclpy raises for wrong `--ros-args`."""
