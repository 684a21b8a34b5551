"""Read a configuration file.

A file is YAML, nested or with dotted keys, plain or in the form of a ROS parameter file:

    tracking.k_y: 8.0                     robot:
    limits: {linear_mps: 0.3}               ros__parameters:
                                              tracking.k_y: 8.0

Aliases are refused: with them, a file of a few lines can expand beyond the memory.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping
from pathlib import Path
from reprlib import repr as short_repr
from typing import Any

from robotctl.base.errors import ConfigError
from robotctl.base.files import open_regular
from robotctl.config.settings import (
    RATE_KEYS,
    Config,
    check_together,
    log_warning,
    warn_of_retired,
    with_setting,
)

MAX_FILE_BYTES = 1_000_000
"""The size of the largest file that is read."""


def load(path: Path, warn: Callable[[str], object] = log_warning) -> Config:
    """Return the configuration in the file `path`; skip retired keys, and call `warn` for each.

    Raises:
        ConfigError: The file cannot be read, or a key or value is not allowed.
    """
    config = Config()
    for key, value in read_settings(path):
        if warn_of_retired(key, warn, f"{path}: "):
            continue
        try:
            config = with_setting(config, key, value)
        except ConfigError as error:
            raise file_error(path, key, error) from None
    try:
        check_together(config.kernel)
    except ConfigError as error:
        raise file_error(path, error.cause.partition(":")[0], error) from None
    return config


def read_settings(path: Path) -> list[tuple[str, object]]:
    """Return each dotted key of a file with its value, unchecked and in the file's order.

    Raises:
        ConfigError: The file cannot be read, or has a key twice.
    """
    settings = list(flatten(_parameters(read_yaml(path), path), path))
    seen: set[str] = set()
    for key, _ in settings:
        if key in seen:
            raise file_error(path, key, ConfigError(f"{key}: is given twice", "keep one of them"))
        seen.add(key)
    return settings


def file_error(path: Path, key: str, error: ConfigError) -> ConfigError:
    """Return `error` with the path of the file and, if found, the number of the line with `key`."""
    line = _line_of(path, key)
    where = f"{path}: " if line is None else f"{path}: line {line}: "
    return ConfigError(f"{where}{error.cause}", error.cure)


def read_value(name: str, text: str) -> object:
    """Return the value of the YAML `text`; the text of an error begins with `name`.

    Raises:
        ConfigError: The text is not valid YAML.
    """
    import yaml

    try:
        return yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError, TypeError, ValueError) as error:
        raise ConfigError(f"{name}: not valid YAML: {' '.join(str(error).split())}") from None


def read_yaml(path: Path) -> Any:
    """Return the content of a YAML file.

    Raises:
        ConfigError: The file cannot be read, is not valid YAML, or has aliases or duplicate keys.
    """
    import yaml  # here: the import lasts 15 ms, and most daemons have no configuration file

    class Loader(yaml.SafeLoader):
        """Refuses aliases and duplicate keys; PyYAML would keep the last value of such a key."""

        def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
            if self.check_event(yaml.AliasEvent):
                raise yaml.YAMLError("aliases are not supported: write the value itself")
            return super().compose_node(parent, index)

        def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> Any:
            seen: set[Hashable] = set()
            for item, _ in node.value:
                key = self.construct_object(item, deep=True)
                if key in seen:
                    raise yaml.YAMLError(f"{short_repr(key)}: is given twice: keep one of them")
                seen.add(key)
            return super().construct_mapping(node, deep)

    try:
        return yaml.load(_text(path), Loader)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}", "give the path of a YAML file") from None
    except (yaml.YAMLError, RecursionError, TypeError, ValueError) as error:
        raise ConfigError(f"{path}: not valid YAML: {' '.join(str(error).split())}") from None


def _text(path: Path) -> bytes:
    with open_regular(path) as file:
        text = file.read(MAX_FILE_BYTES + 1)
    if len(text) > MAX_FILE_BYTES:
        raise ConfigError(f"{path}: larger than {MAX_FILE_BYTES} bytes, not a configuration")
    return text


def _line_of(path: Path, key: str) -> int | None:
    """Return the number of the last line that sets the dotted `key`, None if it is not found."""
    import yaml

    def lines(node: yaml.Node | None, prefix: str) -> Iterator[tuple[str, int]]:
        for name, value in node.value if isinstance(node, yaml.MappingNode) else ():
            yield f"{prefix}{name.value}", name.start_mark.line + 1
            yield from lines(value, f"{prefix}{name.value}.")

    try:
        named = lines(yaml.compose(_text(path), yaml.SafeLoader), "")
        found = [line for name, line in named if f".{name}".endswith(f".{key}")]
    except (OSError, yaml.YAMLError):  # the file was changed meanwhile
        return None
    return found[-1] if found else None


def _parameters(content: Any, path: Path) -> Mapping[Any, Any]:
    """Return the settings of a file; in a ROS parameter file, they are below `ros__parameters`."""
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: not a mapping of keys to values")
    if len(content) == 1:
        (inner,) = content.values()
        if isinstance(inner, dict) and list(inner) == ["ros__parameters"]:
            return _parameters(inner["ros__parameters"], path)
    return content


def flatten(
    settings: Mapping[Any, Any], path: Path, prefix: str = ""
) -> Iterator[tuple[str, object]]:
    """Yield each dotted key and value of nested mappings; a mapping under RATE_KEYS is a value."""
    for name, value in settings.items():
        key = f"{prefix}{name}"
        if isinstance(value, dict) and key not in RATE_KEYS:
            yield from flatten(value, path, f"{key}.")
        else:
            yield key, value
