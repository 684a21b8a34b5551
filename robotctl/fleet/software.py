"""Which robotctl judges: its modules, and what it runs on."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

import robotctl
from robotctl.recording.format.metadata_names import MADE_BY


@cache
def software_hash() -> str:
    """Return the SHA-256 over all modules of robotctl, its version, Python and the C library.

    A check compares numbers exactly only if the recording was made with the same Python and C
    library.
    """
    package = Path(robotctl.__file__).parent
    digest = hashlib.sha256(f"{robotctl.__version__}\n{MADE_BY}\n".encode())
    for path in sorted(package.rglob("*.py")):
        digest.update(f"{path.relative_to(package)}\n".encode() + path.read_bytes())
    return digest.hexdigest()


def software_name() -> str:
    """Return the same for people."""
    return f"robotctl {robotctl.__version__} on {MADE_BY}"
