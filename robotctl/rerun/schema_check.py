"""Checks that the topics that a check reads have the types whose fields it knows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from robotctl.cdr import known_types
from robotctl.kernel import command_types
from robotctl.recording import Recording
from robotctl.recording.format.type_names import type_name_of
from robotctl.rerun.check_report import Report

HASHES: Final[Mapping[str, str]] = {
    command_types.TWIST: "9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a",
    command_types.TWIST_STAMPED: "5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
    known_types.ODOMETRY: "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
    known_types.ROBOT_STATUS: "61598f9d2936bf0665499ce4f458aba4b3e12ede4281ea119ca421cde9331509",
    known_types.JOURNAL_ENTRY: "8ecaa1252cd850455be383c3a05c471a0dbe13d5fc23ae327afcc626da89175a",
    "robot_controller/srv/SetMode_Event": (
        "9e6dda1519f7f4c9b7773852b8742429baebad1dde87e67dcda45a04abedc813"
    ),
    "std_srvs/srv/Trigger_Event": (
        "ec4a1d26b0575e61906890342aba9523a2360e9845857c5590fa6e23bc39e1c2"
    ),
    "sensor_msgs/msg/BatteryState": (
        "4bee5dfce981c98faa6828b868307a0a73f992ed0789f374ee96c8f840e69741"
    ),
    "sensor_msgs/msg/LaserScan": "64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828",
    "sensor_msgs/msg/Joy": "0d356c79cad3401e35ffeb75a96a96e08be3ef896b8b83841d73e890989372c5",
    "sensor_msgs/msg/Imu": "7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b",
    "std_msgs/msg/Bool": "feb91e995ff9ebd09c0cb3d2aed18b11077585839fb5db80193b62d74528f6c9",
    "diagnostic_msgs/msg/DiagnosticArray": (
        "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e"
    ),
}
"""The hash of each type whose messages a check reads, without `RIHS01_`."""

_HASH_KEY: Final = "topic_type_hash"


def check_schemas(recording: Recording, report: Report) -> None:
    """Report each topic that is recorded with another version of its type, or without its hash."""
    for each in recording.open_files:
        for channel in each.index.channels.values():
            name = type_name_of(channel, each.index.schemas.get(channel.schema_id))
            type_hash, topic = channel.metadata.get(_HASH_KEY, ""), channel.topic
            if name not in HASHES:
                continue
            if not type_hash:
                report.miss(f"{topic} is recorded without the definition of its type")
            elif type_hash != f"RIHS01_{HASHES[name]}" or channel.message_encoding != "cdr":
                report.miss(
                    f"{topic} is recorded with another version of {name} than the check reads"
                )
