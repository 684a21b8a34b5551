"""The daemon's configuration: one frozen `Config`, validated when it is read.

- `schema`: what may be set, with the defaults.
- `settings`: read and change a `Config` by dotted keys.
- `values`: whether a value is allowed for a key.
- `declarations`: each key with its type, its allowed values and when it may change.
- `file`: read a `Config` from a YAML file.
"""

from robotctl.config.file import MAX_FILE_BYTES, load
from robotctl.config.schema import Config, RecordingParams
from robotctl.config.settings import (
    PATTERN_HELP,
    Declaration,
    Kind,
    check_all,
    check_together,
    declarations,
    flat,
    is_topic_pattern,
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
