"""What each method takes, with its limits: decoded strictly, once, at the edge of the daemon."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

from robotctl.ipc.protocol import MAX_MARK_LENGTH
from robotctl.kernel.drive import MAX_LAPS
from robotctl.kernel.patterns import MAX_SIZE_M, MAX_SPEED_MPS, MIN_SIZE_M, MIN_SPEED_MPS

Source = Annotated[str, Meta(max_length=200)]
"""Who asked, for the journal and the log."""

Size = Annotated[float, Meta(ge=MIN_SIZE_M, le=MAX_SIZE_M)]


class NoParams(Struct, frozen=True, forbid_unknown_fields=True):
    """For whatever takes none."""


class HelloParams(Struct, frozen=True, forbid_unknown_fields=True):
    """The version that the client speaks."""

    protocol: int


class SetModeParams(Struct, frozen=True, forbid_unknown_fields=True):
    """`mode` is the uint8 of SetMode.srv: a number without a meaning is the kernel's to refuse."""

    mode: Annotated[int, Meta(ge=0, le=255)]
    source: Source


class ResetParams(Struct, frozen=True, forbid_unknown_fields=True):
    """Releases ERROR and EMERGENCY_STOP to IDLE."""

    source: Source


class MarkParams(Struct, frozen=True, forbid_unknown_fields=True):
    """Marks the present moment in the recording."""

    text: Annotated[str, Meta(min_length=1, max_length=MAX_MARK_LENGTH)]
    source: Source


class DriveParams(Struct, frozen=True, forbid_unknown_fields=True):
    """A pattern and its size; what is left out comes from the daemon's configuration.

    The limits are the kernel's; the configured speed limit may be lower.
    """

    pattern: Literal["square", "circle", "figure-eight"]
    source: Source
    side_m: Size | None = None
    radius_m: Size | None = None
    laps: Annotated[int, Meta(ge=0, le=MAX_LAPS)] | None = None
    """0 drives until stopped."""
    speed_mps: Annotated[float, Meta(ge=MIN_SPEED_MPS, le=MAX_SPEED_MPS)] | None = None
    replace: bool = False
    wait: bool = False
