"""`plot` draws the fields that are asked for, and names those there are."""

from __future__ import annotations

import struct
import time
from math import inf, nan
from pathlib import Path
from xml.etree import ElementTree

import pytest
from PIL import Image

from robotctl.messages.definition import parse_definition
from robotctl.messages.values import encode
from tests.cli.conftest import Cli
from tests.support.bags import Line, write_bag

DEFINITION = """\
float64 x
Point place
float32[] ranges
string name
================
MSG: a/Point
float64 x
float64 y
"""
TRANSFORMS = """\
Place[] places
================
MSG: a/Place
string[] names
float64 x
Point[] points
================
MSG: a/Point
int32 y
"""


def write(path: Path, rows: list[tuple[float, list[float]]], definition: str = DEFINITION) -> None:
    """Write messages 0.1 s apart: x, and ranges."""
    lines = []
    for number, (x, ranges) in enumerate(rows):
        data = b"\0\1\0\0" + struct.pack("<3dI", x, 2 * x, 3 * x, len(ranges))
        data += struct.pack(f"<{len(ranges)}fI5s", *ranges, 5, b"name\0")
        lines.append(Line("/t", "a/msg/T", 100.0 * number, data, definition=definition))
    write_bag(path, lines)


@pytest.fixture(autouse=True)
def recording() -> Path:
    path = Path("run.mcap")
    write(path, [(n / 10, [float(n), 5.0]) for n in range(21)])
    return path


def test_a_field_fills_80_by_24_in_a_pipe_without_colour(cli: Cli) -> None:
    out = cli("plot", "run.mcap", "/t", "x").succeeded()
    lines = out.splitlines()
    assert len(lines) == 23
    assert max(map(len, lines)) <= 80
    assert "x  0 to 2, 21 values" in lines[0]
    assert "2.00 s" in lines[-1]
    assert "\x1b" not in out
    drawn = [line[12:].strip(" │") for line in lines[1:-1]]
    ends = [len(line.rstrip()) for line in lines[1:-1] if line[12:].strip(" │")]
    assert ends == sorted(ends, reverse=True)  # it rises from the left below to the right above
    assert sum(map(bool, drawn)) > 15


def test_fields_stand_below_each_other_and_a_message_is_its_numbers(cli: Cli) -> None:
    lines = cli("plot", "run.mcap", "t", "x", "place", "ranges[0]").out.splitlines()
    named = [line.split()[0] for line in lines if "values" in line]
    assert named == ["x", "place.x", "place.y", "ranges[0]"]
    assert "ranges[0]  0 to 20" in "\n".join(lines)


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ((), "its numbers are x, place.x, place.y, ranges[0]"),
        (("plce.x",), "did you mean place?"),
        (("y",), "a/T has no field 'y'"),
        (("ranges",), "choose one value: ranges[0]"),
        (("name",), "name is no number: its numbers are x"),
        (("x.y",), "x is a float64, which has no fields"),
        (("x[0]",), "no list"),
        (("x..y",), "is no path to a field"),
    ],
)
def test_a_path_to_no_number_is_refused_with_those_there_are(
    fields: tuple[str, ...], said: str, cli: Cli
) -> None:
    ran = cli("plot", "run.mcap", "/t", *fields)
    ran.failed(2, said)
    assert ran.out == ""
    assert "did you mean /t?" in cli("plot", "run.mcap", "/tt", *fields).err


def test_values_that_cannot_be_drawn_are_told(cli: Cli) -> None:
    write(Path("odd.mcap"), [(nan, [1.0]), (inf, []), (1.0, [2.0]), (1e300, [3.0])])
    ran = cli("plot", "odd.mcap", "/t", "x", "ranges[0]")
    ran.failed(8, "x: 3 values are no finite numbers", "ranges[0]: 1 messages have a shorter list")
    assert "x  1 to 1, 1 values" in ran.out
    write(Path("other.mcap"), [(1.1, [])] * 3, "string[] a\nfloat64 x\n")
    cli("plot", "other.mcap", "/t", "x").failed(8, "3 messages of /t cannot be decoded")


def test_a_picture_is_written_as_png_and_as_svg(cli: Cli) -> None:
    for name in ("a.png", "a.svg", "a.png"):  # a picture is replaced
        ran = cli("plot", "run.mcap", "/t", "x", "place.x", "-o", name)
        assert (ran.exit_code, ran.out) == (0, f"{name}\n")
    with Image.open("a.png") as image:
        assert image.size[0] == 1920
        assert len(image.convert("RGB").getcolors(1 << 20) or ()) > 3
    root = ElementTree.parse("a.svg").getroot()
    shown = ["".join(each.itertext()) for each in root.iter("{http://www.w3.org/2000/svg}text")]
    assert {"x", "place.x", "2 s"} <= set(shown)


def test_nothing_else_than_a_picture_is_written(recording: Path, cli: Cli, tmp_path: Path) -> None:
    before = recording.read_bytes()
    cli("plot", "run.mcap", "/t", "x", "-o", "run.mcap").failed(2, ".png or .svg")
    assert recording.read_bytes() == before
    Path("link.png").symlink_to(tmp_path / "elsewhere")
    assert cli("plot", "run.mcap", "/t", "x", "-o", "link.png").exit_code == 4
    assert not (tmp_path / "elsewhere").exists()


@pytest.mark.parametrize(
    "values",
    [[5e-324] * 3, [0.0, 5e-324], [1e-310, 3e-310], [-1.2345e-5, -2.5e-5], [-1.2345e14, -2.5e14]],
)
def test_the_smallest_and_the_longest_numbers_can_be_drawn(values: list[float], cli: Cli) -> None:
    write(Path("small.mcap"), [(value, []) for value in values])
    ran = cli("plot", "small.mcap", "/t", "x")
    assert (ran.exit_code, ran.err) == (0, "")
    assert {line.find("\u2502") for line in ran.out.splitlines()[1:-1]} == {11}
    for name in ("small.png", "small.svg"):
        assert cli("plot", "small.mcap", "/t", "x", "-o", name).exit_code == 0


def write_transforms(path: Path) -> None:
    """Write two messages, the first with a list of two messages, the second with none."""
    definition = parse_definition("a/msg/T", TRANSFORMS)
    place = {"names": ["a"], "x": 1.5, "points": [{"y": 3}, {"y": 4}]}
    both = [encode(definition, {"places": places}) for places in ([place, place], [])]
    write_bag(path, [Line("/tf", "a/msg/T", 0.0, data, definition=TRANSFORMS) for data in both])


def test_numbers_of_messages_in_a_list_are_named_and_drawn(cli: Cli) -> None:
    write_transforms(Path("tf.mcap"))
    for fields, said in (
        ((), "its numbers are places[0].x, places[0].points[0].y"),
        (("places",), "choose one value: places[0].x"),
        (("places[1].names",), "places[1].names is no number"),
    ):
        cli("plot", "tf.mcap", "/tf", *fields).failed(2, said)
    ran = cli("plot", "tf.mcap", "/tf", "places[1]", "places[0].points[1].y", "places[2].x")
    ran.failed(8, "places[2].x: 2 messages have a shorter list")
    named = [line.split("  ") for line in ran.out.splitlines() if "values" in line]
    assert [(words[-2].strip(), words[-1]) for words in named] == [
        ("places[1].x", "1.5 to 1.5, 1 values"),
        ("places[0].points[1].y", "4 to 4, 1 values"),
        ("places[2].x", "no values"),
    ]


def test_a_type_of_endless_lists_is_searched_for_a_moment_only(cli: Cli) -> None:
    parts = ["P0[] a\nP0[] b\n"]
    parts += [f"MSG: a/P{n}\nP{n + 1}[] a\nP{n + 1}[] b\n" for n in range(50)]
    parts += ["MSG: a/P50\nstring s\n", *(f"MSG: a/Q{n}\nfloat64 x\n" for n in range(140))]
    write(Path("lists.mcap"), [(0.0, [])], f"{'=' * 80}\n".join(parts))
    before_s = time.process_time()
    assert "it has no numbers" in cli("plot", "lists.mcap", "/t").err
    assert "a is no number: it has no numbers" in cli("plot", "lists.mcap", "/t", "a").err
    assert time.process_time() - before_s < 3.0
