"""The QoS of old bags: before version 9 rosbag2 wrote policies as numbers, since then as names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import yaml

_NAMES: Final[Mapping[str, Mapping[int, str]]] = {
    "history": {0: "system_default", 1: "keep_last", 2: "keep_all"},
    "reliability": {0: "system_default", 1: "reliable", 2: "best_effort"},
    "durability": {0: "system_default", 1: "transient_local", 2: "volatile"},
    "liveliness": {0: "system_default", 1: "automatic", 3: "manual_by_topic"},
}
"""The numbers of rmw_qos_*_policy_e in rmw/types.h; all others are unknown."""

_MAX_CHARACTERS: Final = 1 << 16
"""More than 100 publishers of a topic; a YAML parser is slow."""


def named_policies(profiles: str) -> str:
    """Return a YAML list of QoS profiles with names in place of the numbers of policies.

    Text that is no such list, or has no numbers of policies, is returned as it is.
    """
    if len(profiles) > _MAX_CHARACTERS:
        return profiles
    try:
        found = yaml.safe_load(profiles)
    except (yaml.YAMLError, ValueError, RecursionError):
        return profiles
    if not isinstance(found, list) or not all(isinstance(each, dict) for each in found):
        return profiles
    if not any(isinstance(each.get(policy), int) for each in found for policy in _NAMES):
        return profiles
    return yaml.safe_dump([_named(each) for each in found], sort_keys=False)


def _named(profile: dict[str, Any]) -> dict[str, Any]:
    return {
        key: _NAMES[key].get(value, "unknown")
        if key in _NAMES and isinstance(value, int)
        else value
        for key, value in profile.items()
    }
