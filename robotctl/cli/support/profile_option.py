"""The option that names the profile of a known robot."""

from __future__ import annotations

from typing import Annotated

import typer

from robotctl.profiles import Profile

_NAMES = ", ".join(profile.value for profile in Profile)

ProfileName = Annotated[
    Profile | None,
    typer.Option("--profile", metavar="ROBOT", help=f"Parameters of a known robot: {_NAMES}."),
]
