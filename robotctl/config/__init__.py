"""The daemon's configuration: one frozen `Config`, validated when it is read.

- `schema`: what may be set, with the defaults.
- `settings`: read and change a `Config` by dotted keys.
- `values`: whether a value is allowed for a key.
- `file`: read a `Config` from a YAML file.
"""

from robotctl.config.file import MAX_FILE_BYTES, load
from robotctl.config.schema import Config, RecordingParams
from robotctl.config.settings import check_all, check_together, flat, with_setting, with_text
from robotctl.config.values import PATTERN_HELP, is_topic_pattern

__all__ = [
    "MAX_FILE_BYTES",
    "PATTERN_HELP",
    "Config",
    "RecordingParams",
    "check_all",
    "check_together",
    "flat",
    "is_topic_pattern",
    "load",
    "with_setting",
    "with_text",
]
