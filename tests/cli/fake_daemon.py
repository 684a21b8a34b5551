"""A fake of `python -m robotctl.daemon`: the protocol and the ready line, without a robot.

FAKE_START makes a start go wrong: refuse, run-already, crash, garbage or hang. FAKE_ENDLESS makes
every drive endless, FAKE_GENTLE every ramp; FAKE_MODE is the mode that it is ready in.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from robotctl import __version__
from robotctl.base.errors import Refused
from robotctl.base.paths import log_path, socket_path
from robotctl.ipc.method_params import (
    DriveParams,
    EndDriveParams,
    NoParams,
    ResetParams,
    SetModeParams,
)
from robotctl.ipc.server import ControlServer, Identity, Method
from tests.support.bags import odometry, write_bag

MODES = ["IDLE", "MOVING", "ERROR", "EMERGENCY_STOP"]
DRIVE_S = 0.3
SQUARE = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0]]
START_FAILURES = {
    "refuse": {"ready": False, "error": "robot.yaml: speed: nan is not allowed", "exit_code": 2},
    "run-already": {
        "ready": False,
        "error": "robot 'robot' is already running (pid 4711)",
        "exit_code": 5,
    },
}


DRIVE = {
    "what": "a square",
    "lap": 1,
    "laps": 2,
    "distance_m": 0.4,
    "duration_s": 1.5,
    "cross_track_m": 0.001,
    "cross_track_rms_m": 0.002,
    "cross_track_max_m": 0.003,
    "true_cross_track_max_m": 0.013,
    "heading_rms_rad": 0.01,
    "heading_max_rad": 0.02,
    "closure_m": 0.004,
}


class FakeDaemon:
    def __init__(self, options: argparse.Namespace) -> None:
        self.options = options
        self.mode = 0
        self.asked_by = ""
        self.started = time.monotonic()
        self.stopped = asyncio.Event()
        self.halted = asyncio.Event()
        name = f"{options.robot}_20260101_120000"
        self.file = Path(options.recordings).absolute() / name / f"{name}_0.mcap"
        self.file.parent.mkdir(parents=True)
        write_bag(self.file, [odometry(20.0 * number, 0.0) for number in range(20)])

    async def status(self, _: NoParams) -> dict[str, Any]:
        return {
            "robot": self.options.robot,
            "version": __version__,
            "pid": os.getpid(),
            "mode": MODES[self.mode],
            "phase": "driving" if self.mode == 1 else "",
            "mode_reason": self.asked_by,
            "pose": {"x": 0.5, "y": -0.25, "theta": 1.5},
            "velocity": {"linear": 0.2, "angular": 0.0},
            "battery": 0.87,
            "sim": True,
            "lease": None,
            "namespace": "",
            "stalls": 0,
            "odometry_dropped": 0,
            "drive": DRIVE if self.mode == 1 else None,
            "topics": [
                {"name": "/odom", "type": "nav_msgs/msg/Odometry", "count": 20, "rate": 50.0}
            ],
            "recorder": {
                "state": "recording",
                "file": str(self.file),
                "bytes": self.file.stat().st_size,
                "received": 20,
                "written": 20,
                "queued": 0,
                "dropped": 0,
                "lost": 0,
            },
            "warnings": ["\x1b[2Jforged by a topic name"],
            "domain_id": self.options.domain_id,
            "discovery_range": "LOCALHOST",
            "socket": str(socket_path(self.options.robot)),
            "scheduling": "SCHED_OTHER",
            "uptime_s": time.monotonic() - self.started,
        }

    async def set_mode(self, params: SetModeParams) -> dict[str, Any]:
        if self.mode == 3 and params.mode == 1:
            raise Refused("EMERGENCY_STOP is latched: release it with robotctl reset")
        self.mode = params.mode
        self.asked_by = params.source + (f": {params.reason}" if params.reason else "")
        return {"message": f"Mode changed to {MODES[self.mode]}", "mode": MODES[self.mode]}

    async def reset(self, params: ResetParams) -> dict[str, Any]:
        return await self.set_mode(SetModeParams(0, params.source, params.reason))

    async def drive(self, params: DriveParams) -> dict[str, Any]:
        if self.mode == 1 and not params.replace:
            raise Refused("a drive is under way: add --replace")
        self.mode, self.asked_by = 1, params.source
        answer: dict[str, Any] = {
            "message": f"Driving {params.pattern.value} {params.side_m} m",
            "mode": "MOVING",
        }
        if params.wait:
            endless = params.laps == 0 or "FAKE_ENDLESS" in os.environ
            with suppress(TimeoutError):
                await asyncio.wait_for(self.halted.wait(), 3600 if endless else DRIVE_S)
                raise Refused("the drive ended after 0 laps: stopped", answer={"laps": 0})
            self.mode = 0
            answer |= {
                "message": "Drive finished",
                "mode": "IDLE",
                "laps": 1,
                "distance_m": 4.0,
                "cross_track_rms_m": 0.008,
                "cross_track_max_m": 0.021,
                "closure_m": 0.012,
                "heading_rms_rad": 0.02,
                "heading_max_rad": 0.05,
                "duration_s": 17.3,
            }
        return answer

    async def end_drive(self, params: EndDriveParams) -> dict[str, Any]:
        self.mode, self.asked_by = 0, params.source
        self.halted.set()
        if "FAKE_GENTLE" in os.environ:
            await asyncio.sleep(3600)
        return {"message": "Mode changed to IDLE", "mode": "IDLE"}

    async def path(self, _: NoParams) -> dict[str, Any]:
        return {"reference": SQUARE, "driven": [[x + 0.01, y] for x, y in SQUARE]}

    async def stop(self, _: NoParams) -> dict[str, Any]:
        self.stopped.set()
        return {"message": "Stopped; the recording is closed"}

    async def serve(self) -> None:
        options = self.options
        methods: dict[str, Method[Any]] = {
            "status": Method(NoParams, self.status),
            "set_mode": Method(SetModeParams, self.set_mode),
            "reset": Method(ResetParams, self.reset),
            "drive": Method(DriveParams, self.drive, deadline_s=None),
            "end_drive": Method(EndDriveParams, self.end_drive, deadline_s=None),
            "path": Method(NoParams, self.path),
            "stop": Method(NoParams, self.stop),
        }
        identity = Identity(options.robot, __version__, os.getpid())
        with ControlServer(socket_path(options.robot), methods, identity) as server:
            print(f"ready with {sys.argv[1:]}\nin \x1b[31mred", flush=True)
            say_ready(
                options.ready_fd,
                {
                    "ready": True,
                    "robot": options.robot,
                    "mode": os.environ.get("FAKE_MODE", "IDLE"),
                    "domain_id": options.domain_id,
                    "discovery_range": "LOCALHOST",
                    "sim": True,
                    "stalls": 0,
                    "odometry_dropped": 0,
                    "socket": str(socket_path(options.robot)),
                    "recording": str(self.file),
                    "log": str(log_path(options.robot)),
                    "pid": os.getpid(),
                    "notes": ["a sourced ROS (humble) was left out"],
                },
            )
            serving = asyncio.create_task(server.serve())
            await self.stopped.wait()
            serving.cancel()
            await asyncio.gather(serving, return_exceptions=True)


def say_ready(descriptor: int | None, said: object) -> None:
    if descriptor is not None:
        os.write(descriptor, json.dumps(said).encode() + b"\n")
        os.close(descriptor)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--robot", required=True)
    parser.add_argument("--config")
    parser.add_argument("--recordings", default="recordings")
    parser.add_argument("--drive")
    parser.add_argument("--sim", action=argparse.BooleanOptionalAction)
    parser.add_argument("--domain-id", type=int, default=0)
    parser.add_argument("--observe", action="store_true")
    parser.add_argument("--include", action="append")
    parser.add_argument("--exclude", action="append")
    parser.add_argument("--ready-fd", type=int)
    options = parser.parse_args()
    failure = os.environ.get("FAKE_START")
    if failure in START_FAILURES:
        said = START_FAILURES[failure]
        print("the loser's log", flush=True)
        say_ready(options.ready_fd, said)
        sys.exit(int(str(said["exit_code"])))
    if failure == "crash":
        raise ZeroDivisionError("a bug before READY")
    if failure == "garbage":
        os.write(options.ready_fd, b"not json\n")
        sys.exit(3)
    if failure == "hang":
        time.sleep(3600)
    asyncio.run(FakeDaemon(options).serve())


if __name__ == "__main__":
    main()
