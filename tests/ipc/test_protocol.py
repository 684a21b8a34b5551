"""Any input is parsed or raises ProtocolError, and no other exception.

A refusal tells its remedy once, with commands that work when they are pasted.
The keys of the answers: scripts read them, so keys may be added but never removed.
The start conditions in words.
"""

from __future__ import annotations

import json
import random
import re
from contextlib import suppress
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotctl.cli.registry import COMMANDS
from robotctl.ipc import answers
from robotctl.ipc.advice import CONDITIONS, advice, cure_of, for_robot
from robotctl.ipc.protocol import (
    MAX_DEPTH,
    Code,
    LineBuffer,
    ProtocolError,
    Request,
    encode_request,
    parse_request,
    parse_response,
)
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams
from robotctl.kernel.safety import RULES, Rule, start_conditions
from robotctl.kernel.state import State
from robotctl.kernel.types import Cause, ModeRequested, Remedy, Reply
from robotctl.testing.kernels import ready
from tests.support.lines import run_python

VALID = [
    encode_request(1, "hello", {"protocol": 1}),
    encode_request(2, "set_mode", {"mode": 3, "source": "cli \u00fc"}),
    encode_request(3, "drive", {"pattern": "square", "side_m": 1.5, "wait": True}),
]


def code_of(line: bytes) -> Code:
    with pytest.raises(ProtocolError) as caught:
        parse_request(line)
    return caught.value.code


def member(name: str, text: str) -> bytes:
    return b'{"jsonrpc":"2.0","id":1,"method":"status","params":{"%b":%b}}' % (
        name.encode(),
        text.encode(),
    )


DEEPEST = MAX_DEPTH - 2
"""The depth of a parameter: the message and its params are two levels."""


def nested(depth: int) -> bytes:
    return member("x", "[" * depth + "1" + "]" * depth)


def test_nesting_up_to_the_limit_and_a_whole_surrogate_pair_are_read() -> None:
    assert parse_request(nested(DEEPEST)).params["x"]
    assert parse_request(member("x", '"\\ud83e\\udd16"')).params == {"x": "\U0001f916"}


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"\xff\xfe",
        b"{",
        b"null nul",
        b'"\x01"',
        b"\xef\xbb\xbf{}",
        b"1" * 5000,
        *(member("x", text) for text in ("NaN", "Infinity", "-Infinity", "1e999", "-1e999")),
        nested(DEEPEST + 1),
        nested(100),
        member("x", '"\\ud800"'),  # half a surrogate pair
        b"[" * 20 + b'\\"' * 30_000,  # takes no more time than others
    ],
)
def test_what_is_not_json_is_a_parse_error(line: bytes) -> None:
    assert code_of(line) is Code.PARSE_ERROR


@pytest.mark.parametrize(
    "line",
    [
        b"[]",
        b"3",
        b"{}",
        b'{"jsonrpc":"1.0","id":1,"method":"status"}',
        b'{"jsonrpc":"2.0","method":"status"}',
        b'{"jsonrpc":"2.0","id":null,"method":"status"}',
        b'{"jsonrpc":"2.0","id":true,"method":"status"}',
        b'{"jsonrpc":"2.0","id":1.5,"method":"status"}',
        b'{"jsonrpc":"2.0","id":1e3,"method":"status"}',
        b'{"jsonrpc":"2.0","id":9007199254740994,"method":"status"}',
        b'{"jsonrpc":"2.0","id":1}',
        b'{"jsonrpc":"2.0","id":1,"method":3}',
        b'{"jsonrpc":"2.0","id":1,"method":"status","params":[]}',
        b'{"jsonrpc":"2.0","id":1,"method":"status","param":{}}',
    ],
)
def test_what_is_no_request_is_an_invalid_request(line: bytes) -> None:
    assert code_of(line) is Code.INVALID_REQUEST


@pytest.mark.parametrize(
    "line",
    [
        b'{"jsonrpc":"2.0","id":1}',
        b'{"jsonrpc":"2.0","id":1,"result":1,"error":{"code":1,"message":""}}',
        b'{"jsonrpc":"2.0","id":null,"result":1}',
        b'{"jsonrpc":"2.0","id":1,"error":[]}',
        b'{"jsonrpc":"2.0","id":1,"error":{"code":"1","message":""}}',
        b'{"jsonrpc":"2.0","id":1,"error":{"code":1}}',
        b"garbage",
    ],
)
def test_what_is_no_reply_is_a_protocol_error(line: bytes) -> None:
    with pytest.raises(ProtocolError):
        parse_response(line)


@given(
    st.lists(st.binary(max_size=20).map(lambda b: b.replace(b"\n", b"")), max_size=10), st.data()
)
def test_lines_are_the_same_however_the_bytes_arrive(
    sent: list[bytes], data: st.DataObject
) -> None:
    stream = b"".join(line + b"\n" for line in sent)
    lines, received = LineBuffer(100), []
    while stream:
        size = data.draw(st.integers(1, len(stream)))
        lines.receive(stream[:size])
        stream = stream[size:]
        while (line := lines.next_line()) is not None:
            received.append(line)
    assert received == sent


def outcomes(stream: bytes, chunk: int) -> list[Request | Code]:
    """Return the requests that a server parses from a stream in chunks."""
    lines, seen = LineBuffer(300), list[Request | Code]()
    for start in range(0, len(stream), chunk):
        lines.receive(stream[start : start + chunk])
        while True:
            try:
                if (line := lines.next_line()) is None:
                    break
            except ProtocolError as error:
                return [*seen, error.code]
            try:
                seen.append(parse_request(line))
            except ProtocolError as error:
                seen.append(error.code)
    return seen


def mutated(rng: random.Random) -> bytes:
    """A valid line with some bytes changed, removed, doubled or inserted."""
    line = bytearray(rng.choice(VALID))
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(len(line))
        match rng.randrange(4):
            case 0:
                line[at] = rng.randrange(256)
            case 1:
                del line[at : at + rng.randint(1, 5)]
            case 2:
                line[at:at] = line[at : at + rng.randint(1, 30)]
            case _:
                line[at:at] = rng.choice([b"1e999", b"NaN", b"[" * 20, b'"', b"\\u", b"{", b"\n"])
        if not line:
            break
    return bytes(line) + b"\n"


def test_mutated_requests_raise_nothing_but_protocol_errors() -> None:
    rng = random.Random(1)
    refused = 0
    for _ in range(20_000):
        for line in mutated(rng).splitlines():
            try:
                parse_request(line)
            except ProtocolError:
                refused += 1
            except Exception as error:  # noqa: BLE001 - the very thing that must not be
                pytest.fail(f"{line!r} raised {error!r}")
    assert refused > 10_000


def test_mutated_streams_mean_the_same_whole_and_byte_by_byte() -> None:
    rng = random.Random(2)
    for _ in range(500):
        stream = b"".join(mutated(rng) for _ in range(3))
        assert outcomes(stream, len(stream)) == outcomes(stream, 1), stream


@given(st.binary(max_size=200))
def test_any_bytes_raise_nothing_but_protocol_errors(line: bytes) -> None:
    for parse in (parse_request, parse_response):
        with suppress(ProtocolError):
            parse(line)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=10),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=9), inner),
    max_leaves=12,
)
members = st.sampled_from(["jsonrpc", "id", "method", "params", "result", "error", "code", "data"])


@given(st.dictionaries(members, st.just("2.0") | json_values))
def test_any_json_raises_nothing_but_protocol_errors(message: dict[str, object]) -> None:
    for parse in (parse_request, parse_response):
        with suppress(ProtocolError):
            parse(json.dumps(message).encode())


def test_client_and_protocol_import_the_standard_library_alone() -> None:
    program = (
        "import sys; before = set(sys.modules); import robotctl.ipc.client; "
        "new = {m.partition('.')[0] for m in set(sys.modules) - before}; "
        "print(sorted(new - sys.stdlib_module_names))"
    )
    ran = run_python(program)
    assert ran.stdout == "['robotctl']\n", ran.stderr


SOURCE = "robotctl reset (uid 0, pid 7)"


def refusal_in(rule: Rule, reason: str) -> Reply:
    """Return what the kernel answers to a request to move while a rule holds the robot."""
    state = State(mode=rule.action, reason=reason, cause=rule.cause)
    (reply,) = Kernel(KernelParams(), state).step(ModeRequested(0, 1, Mode.MOVING, SOURCE))
    assert isinstance(reply, Reply)
    assert not reply.ok
    return reply


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.cause.value)
def test_a_refusal_has_its_cure_and_one_reset(rule: Rule) -> None:
    reply = refusal_in(rule, "something is wrong")
    told = advice(reply.message, reply.remedies, "robot")
    assert told.cause == f"moving is refused in {rule.action.name} (something is wrong)"
    assert told.cure.startswith(cure_of(rule.remedy, "robot"))
    assert told.sentence.count("robotctl reset") == 1


@pytest.mark.parametrize("remedy", Remedy)
def test_every_command_of_a_cure_names_the_robot(remedy: Remedy) -> None:
    cure = cure_of(remedy, "r2")
    assert cure
    commands = rf"robotctl (?:{'|'.join(COMMANDS)})\b(?: idle| call \S+ '[^']+')?( --robot r2)?"
    assert all(re.findall(commands, cure)), cure


def test_commands_in_texts_of_other_parts_name_the_robot_once() -> None:
    assert for_robot("see robotctl logs", "robot") == "see robotctl logs"
    named = for_robot("see robotctl logs", "r2")
    assert named == for_robot(named, "r2") == "see robotctl logs --robot r2"


STABLE = {
    answers.Status: (
        "robot version pid mode phase mode_reason pose velocity battery sim stalls "
        "odometry_dropped topics recorder warnings domain_id discovery_range scheduling socket "
        "uptime_s"
    ),
    answers.TopicAnswer: "name type count rate bytes written queued dropped lost throttled unseen",
    answers.RecorderAnswer: "state file bytes received written queued dropped lost throttled",
    answers.RecordStatus: "topics recorder warnings",
    answers.PoseAnswer: "x y theta",
    answers.VelocityAnswer: "linear angular",
    answers.Preflight: "passed conditions",
    answers.ConditionAnswer: "cause condition problem cure",
    answers.StartSummary: (
        "ready robot mode domain_id discovery_range sim socket pid recording log notes"
    ),
    answers.DrivenPath: "reference driven",
    answers.ModeAnswer: "message mode",
    answers.DriveAnswer: (
        "message mode laps distance_m cross_track_rms_m cross_track_max_m closure_m"
    ),
    answers.Committed: "file uncommitted failure",
    answers.FileSplit: "message finished file",
    answers.Marked: "message text time_ns",
}


@pytest.mark.parametrize(("answer", "keys"), STABLE.items(), ids=lambda each: str(each)[:40])
def test_no_key_of_an_answer_goes_away(answer: Any, keys: str) -> None:
    assert set(keys.split()) - set(answer.__annotations__) == set()


def test_each_condition_has_words_of_its_own() -> None:
    bench = ready()
    causes = [
        rule.cause
        for rule, _ in start_conditions(bench.state.health, bench.kernel.params, bench.t_ns)
    ]
    assert len({CONDITIONS[cause] for cause in causes}) == len(causes)
    assert all(CONDITIONS[cause] for cause in Cause)
