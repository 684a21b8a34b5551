"""The configuration of a recording, and the settings that change it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields

from robotctl.base.errors import ConfigError, UsageError
from robotctl.config import Config, check_together, with_text
from robotctl.recording import RecordingInfo
from robotctl.recording.format.names import INFO_RECORD, PARAMETER_PREFIX

_SECTIONS = frozenset(item.name for item in fields(Config))

Settings = Mapping[str, str]
"""Configuration keys and their values, as typed."""


def parse_settings(texts: Iterable[str]) -> Settings:
    """Return the settings of `key=value` texts.

    Raises:
        UsageError: A text is not `key=value`, or the value is not allowed for that key.
    """
    settings: dict[str, str] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals:
            raise UsageError(f"--what-if {text}", "give key=value, such as tracking.k_y=8")
        if key in settings:
            raise UsageError(f"--what-if {key}: stands twice: keep one of them")
        settings[key] = value
        try:
            with_text(Config(), key, value)
        except ConfigError as error:
            raise UsageError(f"--what-if {error}") from None
    return settings


def check_scope(settings: Settings, *, closed_loop: bool) -> None:
    """Check that every key changes the decisions or, with `closed_loop`, the simulated robot.

    Raises:
        UsageError: A key changes neither.
    """
    for key in settings:
        section = key.partition(".")[0]
        if key == "rate_hz" and not closed_loop:
            raise UsageError(
                "--what-if rate_hz: the ticks stay as recorded; with --resim the kernel ticks at "
                "that rate"
            )
        if section == "kernel" or section not in _SECTIONS or (closed_loop and section == "sim"):
            continue
        hint = "; with --resim it changes the simulated robot" if section == "sim" else ""
        raise UsageError(f"--what-if {key}: no decision depends on it{hint}")


def changed(config: Config, settings: Settings) -> Config:
    """Return the configuration with the settings applied.

    Raises:
        ConfigError: The settings do not fit together.
    """
    for key, value in settings.items():
        config = with_text(config, key, value)
    check_together(config.kernel)
    return config


def simulated(config: Config, info: RecordingInfo) -> tuple[Config, list[str]]:
    """Return the configuration with the recorded parameters of the simulated robot.

    The second value lists the recorded keys that are unknown or not allowed in this version.
    """
    unknown = []
    for name, value in info.metadata.get(INFO_RECORD, {}).items():
        key = name.removeprefix(PARAMETER_PREFIX)
        if key != name and key.startswith("sim."):
            try:
                config = with_text(config, key, value)
            except ConfigError:
                unknown.append(key)
    return config, unknown
