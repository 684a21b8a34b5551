"""The standard streams of a process: descriptors 0, 1 and 2. Standard library only."""

from __future__ import annotations

import os


def open_standard_streams() -> None:
    """Open /dev/null in place of each standard stream that is closed.

    Otherwise a socket or file would get its descriptor, and output to stderr would go there.
    """
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(descriptor, True)
    os.close(descriptor)
