"""The errors that robotctl raises on purpose, for programs that use it as a library."""

from robotctl.base.errors import (
    AlreadyRunning,
    ConfigError,
    Divergence,
    Interrupted,
    NoDaemon,
    NotSealed,
    RecoveredWithLoss,
    Refused,
    RobotctlError,
    UnreadableFile,
    UsageError,
)

__all__ = [
    "AlreadyRunning",
    "ConfigError",
    "Divergence",
    "Interrupted",
    "NoDaemon",
    "NotSealed",
    "RecoveredWithLoss",
    "Refused",
    "RobotctlError",
    "UnreadableFile",
    "UsageError",
]
