"""A recording plays for the viewers: from the beginning, with pause, seek and rate."""

from __future__ import annotations

import asyncio
import os
import shutil
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from robotctl.kernel.units import NS_PER_S
from robotctl.recording import Recorder, RecorderOptions, Recording, Topic
from robotctl.testing.drives import GID, START_NS
from robotctl.view.recorded_view import (
    CAPABILITIES,
    MAX_LOG_NS,
    RecordedView,
    span_of_recording,
)
from tests.support.served_view import STRING, Served, served
from tests.support.view_client import ViewClient, view_client

PLAYING, PAUSED, ENDED = 0, 1, 3
LENGTH_S = 20
PERIOD_NS = NS_PER_S // 10
END_NS = START_NS + LENGTH_S * NS_PER_S


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 20 s: /a ten times a second, /b once at the beginning, /c without a type."""
    folder = tmp_path_factory.mktemp("recorded") / "run"
    recorder = Recorder(folder, RecorderOptions(), on_failure=pytest.fail)
    a = recorder.add_topic(Topic("/a", *STRING))
    b = recorder.add_topic(Topic("/b", *STRING))
    c = recorder.add_topic(Topic("/c", "unknown_msgs/msg/Odd", ""))
    recorder.write(b, b"latched", START_NS, START_NS, 1, GID)
    recorder.write(c, b"odd", START_NS, START_NS, 1, GID)
    for number in range(LENGTH_S * 10 + 1):
        at_ns = START_NS + number * PERIOD_NS
        recorder.write(a, b"%d" % number, at_ns, at_ns, number + 1, GID)
    assert not recorder.close().failure
    return folder


@asynccontextmanager
async def playing(file: Path, at_ns: int = 0) -> AsyncIterator[Served]:
    """Play a recording during a block."""
    with Recording(file) as recording:
        span_ns = span_of_recording(recording)
        async with served(capabilities=CAPABILITIES, span_ns=span_ns) as view:
            playback = RecordedView(recording, view.server, span_ns, at_ns)
            task = asyncio.create_task(playback.run())
            try:
                yield view
            finally:
                task.cancel()
                await asyncio.gather(task, return_exceptions=True)


def numbers(client: ViewClient) -> list[int]:
    return [int(each.data) for each in client.of("/a")]


async def paused(client: ViewClient) -> None:
    """Pause, and forget what came before."""
    await client.control(play=False, request_id="pause")
    await client.until(lambda: any(each.request_id == "pause" for each in client.playback))
    await client.receive_for(0.1)
    client.messages.clear()
    client.playback.clear()


async def test_the_whole_recording_comes_in_order_at_its_rate(file: Path) -> None:
    async with playing(file) as view, view_client(view.url) as client:
        await client.subscribe("/a", "/b")
        await client.control(play=True, rate=50.0, seek_ns=START_NS)
        began = asyncio.get_running_loop().time()
        client.messages.clear()
        await client.until(lambda: client.playback and client.playback[-1].status == ENDED)
        took_s = asyncio.get_running_loop().time() - began
        assert list(dict.fromkeys(numbers(client))) == list(range(LENGTH_S * 10 + 1))
        assert took_s > 0.8 * LENGTH_S / 50.0
        assert client.playback[-1].at_ns == END_NS
        assert client.times_ns[-1] == END_NS
        info = client.op("serverInfo")[0]
        assert info["capabilities"] == ["playbackControl", "time"]
        assert info["dataEndTime"]["sec"] - info["dataStartTime"]["sec"] == LENGTH_S


async def test_a_seek_shows_the_state_there_and_goes_on_from_there(file: Path) -> None:
    async with playing(file) as view, view_client(view.url) as client:
        await client.subscribe("/a", "/b")
        await paused(client)
        at_ns = START_NS + 10 * NS_PER_S
        await client.control(play=False, seek_ns=at_ns, request_id="seek")
        await client.until(lambda: client.of("/b") and client.of("/a"))
        assert numbers(client) == [99]
        assert client.of("/b")[0].log_ns == START_NS
        await client.receive_for(0.3)
        assert numbers(client) == [99]  # it is paused
        (answer,) = client.playback
        assert answer == (PAUSED, at_ns, 1.0, True, "seek")
        await client.control(play=True, rate=10.0)
        await client.until(lambda: 120 in numbers(client))
        assert numbers(client)[1:] == list(range(100, numbers(client)[-1] + 1))


async def test_no_message_is_lost_while_another_viewer_subscribes(file: Path) -> None:
    async with playing(file) as view, view_client(view.url) as one, view_client(view.url) as two:
        await one.subscribe("/a")
        await one.control(play=True, rate=10.0, seek_ns=START_NS)
        while not (one.playback and one.playback[-1].status == ENDED):
            await two.subscribe("/b")
            await one.receive_for(0.05)
            await two.unsubscribe("/b")
            await one.receive_for(0.05)
        assert set(numbers(one)) == set(range(LENGTH_S * 10 + 1))


async def test_it_begins_at_a_given_moment(file: Path) -> None:
    at_ns = START_NS + 10 * NS_PER_S
    async with playing(file, at_ns) as view, view_client(view.url) as client:
        await client.subscribe("/a", "/b")
        await client.until(lambda: 101 in numbers(client) and client.of("/b"))
        assert numbers(client)[0] in (99, 100)


async def test_a_seek_backwards_and_beyond_the_end_is_possible(file: Path) -> None:
    async with playing(file) as view, view_client(view.url) as client:
        await client.subscribe("/a")
        await paused(client)
        await client.control(play=True, seek_ns=END_NS + NS_PER_S, request_id="beyond")
        await client.until(lambda: client.playback)
        assert client.playback[0] == (ENDED, END_NS, 1.0, True, "beyond")
        client.playback.clear()
        client.messages.clear()
        await client.control(play=True, rate=10.0, request_id="again")
        await client.until(lambda: client.playback and 5 in numbers(client))
        assert client.playback[0].status == PLAYING
        assert client.playback[0].did_seek


async def test_it_waits_for_the_first_viewer_and_pauses_without_one(file: Path) -> None:
    async with playing(file) as view:
        await asyncio.sleep(0.2)
        async with view_client(view.url) as client:
            await client.subscribe("/a")
            await client.until(lambda: client.of("/a"))
            first = client.of("/a")[0].log_ns
            assert first < START_NS + NS_PER_S
        await asyncio.sleep(0.3)
        async with view_client(view.url) as client:
            await client.until(lambda: client.playback)
            assert client.playback[0].at_ns < first + NS_PER_S


async def test_an_older_client_gets_messages_but_no_playback_states(file: Path) -> None:
    async with (
        playing(file) as view,
        view_client(view.url, subprotocol="foxglove.websocket.v1") as old,
        view_client(view.url) as new,
    ):
        await old.subscribe("/a")
        await new.control(play=True, rate=5.0)
        await new.until(lambda: new.playback)
        await old.until(lambda: len(old.of("/a")) > 3)
        assert old.playback == []


async def test_a_recording_at_the_last_time_that_a_file_can_hold_plays(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run", RecorderOptions(), on_failure=pytest.fail)
    recorder.write(recorder.add_topic(Topic("/a", *STRING)), b"1", MAX_LOG_NS, 0, 1, GID)
    assert not recorder.close().failure
    async with playing(tmp_path / "run") as view, view_client(view.url) as client:
        await client.subscribe("/a")
        await client.control(play=True, rate=10.0)
        await client.until(lambda: client.playback and client.playback[-1].status == ENDED)
        assert client.playback[-1].at_ns == MAX_LOG_NS
        await client.until(lambda: client.of("/a"))


async def test_each_lost_part_is_named_however_often_it_is_read(file: Path, tmp_path: Path) -> None:
    """The file is truncated while it plays, and again after 30 seeks."""
    copy = shutil.copytree(file, tmp_path / "run")
    (mcap,) = copy.glob("*.mcap")
    with Recording(copy) as recording:
        chunk = recording.open_files[0].index.places[0]
    async with playing(copy) as view, view_client(view.url) as client:
        await client.subscribe("/a", "/b")
        await client.until(lambda: client.of("/b"))
        for left in (chunk.offset + chunk.length - 1, chunk.offset + 1):
            os.truncate(mcap, left)
            for number in range(30):
                await client.control(play=False, seek_ns=END_NS, request_id=f"{left} {number}")
                await client.until(
                    lambda: client.playback[-1].request_id == f"{left} {number}"  # noqa: B023
                )
                await client.receive_for(0.02)
            told = [each["message"] for each in client.op("status")]
            assert any(f"truncated at byte {left}" in each for each in told), told
        assert "and more" not in told


async def test_a_topic_whose_type_is_not_recorded_is_named(file: Path) -> None:
    async with playing(file) as view, view_client(view.url) as client:
        await client.until(lambda: client.op("status"))
        assert client.op("status")[0]["message"] == (
            "/c is not shown: its type is not in the recording"
        )
        assert "/c" not in client.channels
