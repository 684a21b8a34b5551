"""Makes the pictures of the pages: python docs/pictures.py (it drives the demo, 30 s)."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from shutil import copyfile
from tempfile import TemporaryDirectory


def make() -> None:
    """Drive the demo in an empty folder, and keep its picture."""
    with TemporaryDirectory() as folder:
        ran = subprocess.run(
            [Path(sys.executable).with_name("robotctl"), "demo", "--json"],
            cwd=folder,
            capture_output=True,
            check=True,
        )
        copyfile(
            Path(folder) / json.loads(ran.stdout)["picture"], Path(__file__).parent / "demo.png"
        )


if __name__ == "__main__":
    make()
