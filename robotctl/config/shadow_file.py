"""The file that `shadow` names: the parameters that a second kernel has other than the first."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from robotctl.config.file import file_error, read_settings
from robotctl.config.schema import Config
from robotctl.config.settings import check_together, flat, with_setting
from robotctl.errors import ConfigError
from robotctl.kernel.codec import to_json
from robotctl.kernel.parameters import kernel_leaves
from robotctl.kernel.params import KernelParams


@dataclass(frozen=True, slots=True)
class ShadowSettings:
    """All parameters of the second kernel; `own` are those of its file, as texts by key."""

    file: Path
    params: KernelParams
    own: Mapping[str, str]

    @property
    def digest(self) -> str:
        """The beginning of the SHA-256 of all parameters, as the journal writes them."""
        return hashlib.sha256(to_json(self.params).encode()).hexdigest()[:16]


def read_shadow(config: Config) -> ShadowSettings | None:
    """Return the parameters of the shadow, None if the configuration names no file.

    What the file does not name is as in `config`.

    Raises:
        ConfigError: The file cannot be read, or no decision depends on a key, or a value is not
            allowed.
    """
    if not config.shadow:
        return None
    path, changed = Path(config.shadow), config
    settings = read_settings(path)
    for key, value in settings:
        try:
            changed = with_setting(changed, key, value)
            _check_key(key)
        except ConfigError as error:
            raise file_error(path, key, error) from None
    try:
        check_together(changed.kernel)
    except ConfigError as error:
        raise file_error(path, error.cause.partition(":")[0], error) from None
    values = flat(changed)
    return ShadowSettings(path, changed.kernel, {key: str(values[key]) for key, _ in settings})


def _check_key(key: str) -> None:
    if key == "rate_hz":
        raise ConfigError(f"{key}: the shadow decides on the ticks of the robot", "leave it out")
    if key not in kernel_leaves():
        raise ConfigError(f"{key}: no decision depends on it", "leave it out")
