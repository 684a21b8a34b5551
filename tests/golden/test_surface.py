"""Names that others rely on stay: additions are allowed, a rename needs the old name as well."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, cast

import msgspec
import pytest

from robotctl.base import errors
from robotctl.check.compare import Vocabulary
from robotctl.check.journal import read_effect, read_event, read_snapshot
from robotctl.check.report import Verdict
from robotctl.config import Config, flat, load
from robotctl.daemon.api.driving import DrivingMethods
from robotctl.daemon.api.lease import LeaseMethods
from robotctl.daemon.api.simulation import simulation_methods
from robotctl.daemon.api.status import common_methods, graph_methods, recording_methods
from robotctl.daemon.parameters import parameter_methods
from robotctl.ipc.method_params import HelloParams
from robotctl.ipc.protocol import PROTOCOL_VERSION
from robotctl.ipc.server import Method
from robotctl.kernel.codec import to_json
from robotctl.recording.format.journal import EntryKind, JournalEntry

GOLDEN = Path(__file__).parent
READERS = {
    EntryKind.EVENT: read_event,
    EntryKind.EFFECT: read_effect,
    EntryKind.SNAPSHOT: read_snapshot,
}

EXIT_CODES = {
    "RobotctlError": 1,
    "UsageError": 2,
    "ConfigError": 2,
    "NoDaemon": 3,
    "Refused": 4,
    "AlreadyRunning": 5,
    "UnreadableFile": 6,
    "Divergence": 7,
    "RecoveredWithLoss": 8,
}


def lines(name: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (GOLDEN / name).read_text().splitlines()]


def holds(ours: Any, golden: Any) -> bool:
    """Whether all that the golden value says stands in ours, too."""
    if isinstance(golden, dict):
        return isinstance(ours, dict) and all(
            name in ours and holds(ours[name], value) for name, value in golden.items()
        )
    if isinstance(golden, list):
        return len(ours) == len(golden) and all(map(holds, ours, golden))
    return repr(ours) == repr(golden)


@pytest.mark.parametrize(
    "line", lines("journal.jsonl"), ids=lambda line: f"{line['kind']}-{line['name']}"
)
def test_each_golden_journal_entry_is_read_with_all_its_fields(line: dict[str, Any]) -> None:
    kind = EntryKind[line["kind"].upper()]
    entry = JournalEntry(0, 1, kind, line["name"], json.dumps(line["data"]))
    assert Vocabulary().unknown_field(entry) == ""
    assert holds(json.loads(to_json(READERS[kind](entry))), line["data"])


def test_no_key_of_a_configuration_file_goes_away(tmp_path: Path) -> None:
    golden = (GOLDEN / "config_keys.txt").read_text().split()
    assert sorted(golden) == golden
    values = flat(Config())
    assert [key for key in golden if key not in values] == []
    file = tmp_path / "robot.yaml"
    file.write_text("".join(f"{key}: {json.dumps(values[key])}\n" for key in golden))
    assert load(file) == Config()


@pytest.mark.parametrize(
    "line", lines("requests.jsonl"), ids=lambda line: f"{line['method']}-{len(line['params'])}"
)
def test_each_golden_request_is_taken(line: dict[str, Any]) -> None:
    nothing = cast(Any, None)  # what carries a method out is not called
    methods: dict[str, Method[Any]] = {
        **common_methods(nothing, nothing),
        **recording_methods(nothing, "robot"),
        **parameter_methods(nothing, "robot"),
        **graph_methods(nothing),
        **DrivingMethods(nothing, nothing, nothing).table(),
        **LeaseMethods(nothing).table(),
        **simulation_methods(nothing, nothing, nothing),
    }
    params = HelloParams if line["method"] == "hello" else methods[line["method"]].params
    taken = msgspec.to_builtins(msgspec.convert(line["params"], params))
    assert holds(taken, line["params"])


def test_the_protocol_of_the_socket_is_the_golden_one() -> None:
    (hello,) = (line for line in lines("requests.jsonl") if line["method"] == "hello")
    assert hello["params"]["protocol"] == PROTOCOL_VERSION


def test_exit_codes_stay_what_scripts_count_on() -> None:
    assert {name: getattr(errors, name).exit_code for name in EXIT_CODES} == EXIT_CODES
    assert errors.INTERRUPTED_EXIT_CODE == 130
    codes = {"same": 0, "incomplete": 6, "diverged": 7, "broken": 7}
    assert {verdict.value: verdict.exit_code for verdict in Verdict} == codes
