"""Who may connect: the right token, a Host that nobody else controls, and a known page or none."""

from __future__ import annotations

import socket

import pytest

from robotctl.base.errors import UsageError
from robotctl.cli.commands.daemon.view import view
from robotctl.view.admission import KNOWN_ORIGINS, Admission
from robotctl.view.view_job import is_origin

TOKEN = "T0ken_of-this-run"
TARGET = f"/?token={TOKEN}"
HOST = "127.0.0.1:8765"
ADMISSION = Admission(TOKEN)


@pytest.mark.parametrize(
    "host", [HOST, "localhost:8765", "[::1]:8765", "192.168.1.7:9", f"{socket.gethostname()}:8765"]
)
@pytest.mark.parametrize("origins", [[], *([each] for each in KNOWN_ORIGINS)])
def test_known_pages_and_programs_are_admitted(host: str, origins: list[str]) -> None:
    assert ADMISSION.refusal(TARGET, [host], origins) == ""


@pytest.mark.parametrize(
    "hosts",
    [
        [],
        [HOST, HOST],
        [""],
        ["evil.example:8765"],
        ["localhost.evil.example"],
        ["127.0.0.1.evil.example:8765"],
        ["evil.example@127.0.0.1.x"],
        ["[::1"],
        ["127.1:8765"],
        ["2130706433:8765"],
    ],
)
def test_a_host_that_others_may_control_is_refused(hosts: list[str]) -> None:
    assert "Host" in ADMISSION.refusal(TARGET, hosts, [])


@pytest.mark.parametrize(
    "origins",
    [
        ["https://evil.example"],
        ["null"],
        ["http://app.foxglove.dev"],
        ["https://app.foxglove.dev.evil.example"],
        ["https://app.foxglove.dev", "https://evil.example"],
        ["http://localhost:3000"],
        [""],
    ],
)
def test_pages_of_other_origins_are_refused(origins: list[str]) -> None:
    assert "origin" in ADMISSION.refusal(TARGET, [HOST], origins)


def test_an_origin_of_the_user_is_admitted() -> None:
    own = Admission(TOKEN, ["https://lichtblick.example.org"])
    assert own.refusal(TARGET, [HOST], ["https://lichtblick.example.org"]) == ""


@pytest.mark.parametrize("host", ["127.1", "Robot.lan"])
def test_the_name_that_the_view_was_told_to_listen_on_is_admitted(host: str) -> None:
    """The URL that is printed has this name."""
    own = Admission(TOKEN, host=host)
    assert own.refusal(TARGET, [f"{host}:8765"], []) == ""
    assert "Host" in own.refusal(TARGET, [f"{host}.evil.example:8765"], [])


@pytest.mark.parametrize("origin", [*KNOWN_ORIGINS, "null", "app://x", "http://[::1]:8080"])
def test_what_a_browser_can_send_is_an_origin(origin: str) -> None:
    assert is_origin(origin)


@pytest.mark.parametrize(
    "text",
    [
        *("", "*", "x.org", "https://x.org/", "https://X.org", "https://*.org", "https://"),
        "https://a b",
    ],
)
def test_what_no_browser_sends_is_no_origin_and_refused_by_the_command(text: str) -> None:
    assert not is_origin(text)
    with pytest.raises(UsageError, match=r"--origin .* such as https://"):
        view(origin=["https://x.org", text])


@pytest.mark.parametrize(
    "target",
    [
        *("/", "/?token=", "/?token=T0ken_of-another", f"/?token={TOKEN[:-1]}"),
        *(f"/?token={TOKEN}x", f"/?token=other&token={TOKEN}", f"/?Token={TOKEN}", f"/{TOKEN}"),
        *("/?token=%ff", "//["),
    ],
)
def test_a_url_without_the_token_of_this_run_is_refused(target: str) -> None:
    assert "token" in ADMISSION.refusal(target, [HOST], [])
