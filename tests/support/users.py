"""Runs code in a process of another user, in tests that root runs."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping

import pytest

as_root = pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")

_BECOME = (
    "os.setgroups({groups}); os.setresgid({gid}, {gid}, {gid}); os.setresuid({uid}, {uid}, {uid})"
)


def process_of(
    uid: int, groups: list[int], imports: str, code: str, environment: Mapping[str, str]
) -> subprocess.Popen[str]:
    """Start a process that runs `imports` as root, and then `code` as the user `uid`.

    The imports come first, because the user may have no right to read this checkout.
    """
    become = _BECOME.format(uid=uid, gid=uid, groups=groups)
    return subprocess.Popen(
        [sys.executable, "-c", f"import os\n{imports}\n{become}\n{code}"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=dict(environment),
    )
