"""Configuration files for known robots, which a user copies and adapts."""

from __future__ import annotations

from enum import Enum
from pathlib import Path


class Profile(Enum):
    """The robots for which there is a profile; the value is its file name without `.yaml`."""

    TURTLEBOT3 = "turtlebot3"
    TURTLEBOT4 = "turtlebot4"
    HUSKY = "husky"
    DIFF_DRIVE = "diff-drive"

    @property
    def path(self) -> Path:
        """The path of the YAML file."""
        return Path(__file__).with_name(f"{self.value}.yaml")
