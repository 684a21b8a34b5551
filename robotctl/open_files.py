"""How many files a daemon opens: with a simulated robot about 100; clients and topics add some."""

from typing import Final

LEAST: Final = 128
"""With fewer, a daemon does not start: without a free one it could answer no client."""

ENOUGH: Final = 256
CURE: Final = "raise the limit with ulimit -n 1024, or LimitNOFILE in a unit"
