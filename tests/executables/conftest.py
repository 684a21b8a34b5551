"""The executables of the tutorial as processes, and as nodes."""

import tests.support.rosidl_parser  # noqa: F401
