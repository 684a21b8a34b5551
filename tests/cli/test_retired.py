"""What a version retired answers with what to use instead."""

from __future__ import annotations

import pytest

from robotctl.base import retired
from robotctl.cli import app
from robotctl.cli.registry import COMMANDS


def test_a_retired_command_names_what_replaces_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(retired, "COMMANDS", {"steer": "use: robotctl drive"})
    assert app.run(["steer", "left"]) == 2
    assert "use: robotctl drive" in capsys.readouterr().err


def test_a_retired_option_names_what_replaces_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(retired, "OPTIONS", {("info", "--steer"): "use: robotctl drive"})
    assert app.run(["info", "last", "--steer"]) == 2
    assert "--steer is retired: use: robotctl drive" in capsys.readouterr().err


@pytest.mark.parametrize(("command", "option"), sorted(retired.OPTIONS))
def test_each_retired_option_answers_so(
    command: str, option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert app.run([*command.split(), option]) == 2
    assert retired.OPTIONS[command, option] in capsys.readouterr().err


@pytest.mark.parametrize("command", sorted(retired.ARGUMENTS))
def test_each_retired_argument_answers_so(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert app.run([*command.split(), "word"]) == 2
    assert retired.ARGUMENTS[command] in capsys.readouterr().err


def test_no_command_of_today_is_retired() -> None:
    assert not set(retired.COMMANDS) & set(COMMANDS)
