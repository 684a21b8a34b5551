"""Find a topic of a recording by its name, and by its type where it has several."""

from __future__ import annotations

from collections.abc import Sequence

from robotctl.errors import UnreadableFile, UsageError
from robotctl.recording.read.info import RecordingInfo, TopicInfo
from robotctl.unknown_name import unknown_name

_ENCODING = "cdr"


def choose_topic(info: RecordingInfo, name: str, type_name: str, *, listing: str) -> TopicInfo:
    """Return the topic `name`, whose leading / may be left out; "" takes any `type_name`.

    `listing` is the command that lists the topics.

    Raises:
        UsageError: The recording has no such topic, or it has several types.
        UnreadableFile: Its messages are not in CDR.
    """
    names = {each.name for each in info.topics}
    full_name = name if name in names else f"/{name}"
    if full_name not in names:
        cause, cure = unknown_name("topic", name, names)
        cure = cure if cure.startswith("did you mean") else f"see: {listing}"
        raise UsageError(f"{cause} in {info.path}", cure)
    found = _of_type([each for each in info.topics if each.name == full_name], type_name)
    if found.encoding != _ENCODING:
        raise UnreadableFile(
            f"{found.name} has messages in {found.encoding or 'no encoding'}, not in {_ENCODING}"
        )
    return found


def _of_type(found: Sequence[TopicInfo], wanted: str) -> TopicInfo:
    chosen = [each for each in found if wanted in ("", each.type_name)]
    if len(chosen) == 1:
        return chosen[0]
    types = ", ".join(each.type_name for each in found)
    raise UsageError(
        f"{found[0].name} has the types {types} there", f"choose one: --type {found[0].type_name}"
    )
