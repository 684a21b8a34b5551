"""What rclpy needs of a type to publish serialized messages, without the import of its class.

The class of a type brings all modules of its package, and numpy: 80 ms of CPU for an Odometry.
"""

from __future__ import annotations

import re
from functools import lru_cache
from importlib import import_module
from typing import Any, Final

from robotctl.ros.messages.classes import UnusableType, is_installed, message_class, parse_type_name

_WORD: Final = re.compile(r"(?<=.)(?=[A-Z][a-z])|(?<=[a-z0-9])(?=[A-Z])")
"""Where rosidl puts an underscore into the name of a type."""

_OF_RCLPY: Final = (
    *("type_support", "create_ros_message", "destroy_ros_message"),
    *("convert_from_py", "convert_to_py"),
)
"""What rclpy looks for in the metaclass of a type, in capitals and after an underscore."""


@lru_cache(maxsize=1024)
def serialized_type(type_name: str) -> Any:
    """Return a class of `pkg/msg/T` for publishers of serialized messages; it has no fields.

    Of another kind, such as `pkg/srv/T_Event`, the whole class.

    Raises:
        UnusableType: The ament index does not list the type, or loading it failed.
    """
    name = parse_type_name(type_name)
    if name.kind != "msg":
        return message_class(type_name)
    if not is_installed(name):
        raise UnusableType("is not installed")
    suffix = f"msg__msg__{_WORD.sub('_', name.short).lower()}"
    try:
        module = import_module(f"{name.package}.{name.package}_s__rosidl_typesupport_c")
        found = {f"_{each.upper()}": getattr(module, f"{each}_{suffix}") for each in _OF_RCLPY}
    except Exception as error:
        raise UnusableType(f"cannot be loaded ({type(error).__name__}: {error})") from error
    return type(f"Metaclass_{name.short}", (type,), found)(name.short, (), {})
