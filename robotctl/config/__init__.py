"""The daemon's configuration: one frozen `Config`, validated when it is read.

- `settings`: all settings, by dotted keys or from a file.
- `ros_settings`: settings from ROS parameter files and `--ros-args`.
"""

from robotctl.config.settings import (
    MAX_FILE_BYTES,
    PATTERN_HELP,
    Config,
    Declaration,
    Kind,
    RecordingParams,
    check_all,
    check_together,
    declarations,
    flat,
    is_topic_pattern,
    load,
    with_setting,
    with_text,
)

__all__ = [
    "MAX_FILE_BYTES",
    "PATTERN_HELP",
    "Config",
    "Declaration",
    "Kind",
    "RecordingParams",
    "check_all",
    "check_together",
    "declarations",
    "flat",
    "is_topic_pattern",
    "load",
    "with_setting",
    "with_text",
]
