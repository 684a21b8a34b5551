"""Any input is parsed or raises ProtocolError, and no other exception."""

from __future__ import annotations

import json
import random
import subprocess
import sys
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotctl.ipc.protocol import (
    MAX_DEPTH,
    Code,
    Failure,
    LineBuffer,
    ProtocolError,
    Request,
    Result,
    encode_error,
    encode_request,
    is_emergency_stop,
    parse_request,
    parse_response,
)

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


def test_a_request_survives_its_journey() -> None:
    line = encode_request(9, "drive", {"side_m": 1.5, "pattern": "square"})
    assert line.endswith(b"\n")
    assert parse_request(line) == Request(9, "drive", {"side_m": 1.5, "pattern": "square"})


def test_params_may_be_left_out() -> None:
    assert parse_request(b'{"jsonrpc":"2.0","id":"a","method":"stop"}') == Request("a", "stop", {})


@pytest.mark.parametrize(
    "text", ["NaN", "Infinity", "-Infinity", "1e999", "-1e999", "[" * 100 + "]" * 100]
)
def test_what_python_takes_for_a_number_and_json_does_not_is_a_parse_error(text: str) -> None:
    assert code_of(member("x", text)) is Code.PARSE_ERROR


def test_a_duplicate_key_is_a_parse_error_at_every_level() -> None:
    assert code_of(member("x", '{"a":1,"a":2}')) is Code.PARSE_ERROR
    assert code_of(b'{"jsonrpc":"2.0","id":1,"id":2,"method":"status"}') is Code.PARSE_ERROR


@pytest.mark.parametrize("opening", [b"[", b'{"a":'])
def test_deep_nesting_is_a_parse_error_and_never_a_recursion(opening: bytes) -> None:
    assert code_of(opening * 10_000) is Code.PARSE_ERROR


def test_brackets_inside_text_are_not_nesting() -> None:
    text = '"' + "[{" * 50 + '\\"[' + '"'
    assert parse_request(member("x", text)).params == {"x": "[{" * 50 + '"['}


def test_nesting_is_allowed_up_to_the_limit() -> None:
    inner = MAX_DEPTH - 2  # the message and its params are two levels
    assert parse_request(member("x", "[" * inner + "1" + "]" * inner)).params["x"]
    assert code_of(member("x", "[" * (inner + 1) + "]" * (inner + 1))) is Code.PARSE_ERROR


def test_many_lists_side_by_side_are_not_deep() -> None:
    points = json.dumps([[1.0, 2.0]] * 1000)
    assert len(parse_request(member("x", points)).params["x"]) == 1000


def test_a_line_of_escaped_quotes_takes_no_more_time_than_others() -> None:
    assert code_of(b"[" * 20 + b'\\"' * 30_000) is Code.PARSE_ERROR


@pytest.mark.parametrize(
    "line", [b"", b"\xff\xfe", b"{", b"null nul", b'"\x01"', b"\xef\xbb\xbf{}", b"1" * 5000]
)
def test_what_is_not_json_is_a_parse_error(line: bytes) -> None:
    assert code_of(line) is Code.PARSE_ERROR


def test_half_a_surrogate_pair_is_a_parse_error() -> None:
    assert code_of(member("x", '"\\ud800"')) is Code.PARSE_ERROR
    assert parse_request(member("x", '"\\ud83e\\udd16"')).params == {"x": "\U0001f916"}


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


def test_an_invalid_request_is_answered_under_its_id() -> None:
    with pytest.raises(ProtocolError) as caught:
        parse_request(b'{"jsonrpc":"2.0","id":"x","method":3}')
    assert caught.value.request_id == "x"


def test_an_error_survives_its_journey_with_its_exit_code() -> None:
    line = encode_error(4, Code.ROBOTCTL_ERROR, "refused", 4)
    assert parse_response(line) == Failure(4, -32000, "refused", {"exit_code": 4})


def test_a_result_survives_its_journey() -> None:
    line = b'{"jsonrpc":"2.0","id":4,"result":{"mode":"IDLE"}}'
    assert parse_response(line) == Result(4, {"mode": "IDLE"})


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


@pytest.mark.parametrize(
    ("params", "expected"),
    [
        ({"mode": 3}, True),
        ({"mode": 3, "source": "x"}, True),
        ({"mode": 1}, False),
        ({"mode": 3.0}, False),
        ({"mode": "3"}, False),
        ({}, False),
    ],
)
def test_only_set_mode_3_is_the_emergency_stop(params: dict[str, object], expected: bool) -> None:
    assert is_emergency_stop(Request(1, "set_mode", params)) is expected
    assert not is_emergency_stop(Request(1, "drive", params))


def test_a_line_over_the_limit_is_refused_before_it_is_whole() -> None:
    lines = LineBuffer(10)
    lines.receive(b"0123456789\n0123456789")
    assert lines.next_line() == b"0123456789"
    assert lines.next_line() is None
    lines.receive(b"x")
    with pytest.raises(ProtocolError):
        lines.next_line()


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


def test_100k_mutated_requests_raise_nothing_but_protocol_errors() -> None:
    rng = random.Random(1)
    refused = 0
    for _ in range(100_000):
        for line in mutated(rng).splitlines():
            try:
                parse_request(line)
            except ProtocolError:
                refused += 1
            except Exception as error:  # noqa: BLE001 - the very thing that must not be
                pytest.fail(f"{line!r} raised {error!r}")
    assert refused > 50_000


def test_mutated_streams_mean_the_same_whole_and_byte_by_byte() -> None:
    rng = random.Random(2)
    for _ in range(2_000):
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
    ran = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, check=True, text=True
    )
    assert ran.stdout.strip() == "['robotctl']"
