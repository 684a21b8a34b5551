"""Units of time."""

from typing import Final

NS_PER_S: Final = 1_000_000_000
DAY_S: Final = 86_400.0
