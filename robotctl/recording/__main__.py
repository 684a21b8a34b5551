"""`python -m robotctl.recording JOB`: cuts one clip at the lowest priority.

JOB is the JSON object of a ClipJob. One line of JSON on stdout: {"target", "lost"} or {"error"}.
"""

from __future__ import annotations

import json
import os
import sys

os.nice(19)  # before anything is imported: somebody controls a robot on this machine

from robotctl.errors import RobotctlError  # noqa: E402
from robotctl.recording.clip_job import ClipJob, make_clip  # noqa: E402


def main(job: str) -> int:
    """Cut the clip and return the exit code."""
    try:
        made = make_clip(ClipJob.from_json(job))
    except RobotctlError as error:
        print(json.dumps({"error": str(error)}))
        return error.exit_code
    print(json.dumps({"target": str(made.target), "lost": list(made.lost)}))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
