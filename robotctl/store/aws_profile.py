"""The keys of a profile of the AWS command line, which obstore does not read."""

from __future__ import annotations

from collections.abc import Mapping
from configparser import ConfigParser, Error
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from obstore.store import S3Config

_OTHER_SOURCES: Final = frozenset(
    {
        "AWS_ACCESS_KEY_ID",
        "AWS_SKIP_SIGNATURE",
        "AWS_WEB_IDENTITY_TOKEN_FILE",
        "AWS_CONTAINER_CREDENTIALS_RELATIVE_URI",
        "AWS_CONTAINER_CREDENTIALS_FULL_URI",
    }
)
_DEFAULT: Final = "default"


def profile_keys(environment: Mapping[str, str]) -> S3Config:
    """Return keys and region of the profile in AWS_PROFILE, or of the default one.

    Nothing is returned if the environment names keys itself, or there are none in the profile.
    """
    if _OTHER_SOURCES & environment.keys():
        return {}
    profile = environment.get("AWS_PROFILE", _DEFAULT)
    in_config = profile if profile == _DEFAULT else f"profile {profile}"
    keys = _section(environment.get("AWS_SHARED_CREDENTIALS_FILE", "~/.aws/credentials"), profile)
    other = _section(environment.get("AWS_CONFIG_FILE", "~/.aws/config"), in_config)
    told = other | keys
    if not {"aws_access_key_id", "aws_secret_access_key"} <= told.keys():
        return {}
    found: S3Config = {
        "access_key_id": told["aws_access_key_id"],
        "secret_access_key": told["aws_secret_access_key"],
    }
    if "aws_session_token" in told:
        found["session_token"] = told["aws_session_token"]
    if "region" in told and not {"AWS_REGION", "AWS_DEFAULT_REGION"} & environment.keys():
        found["region"] = told["region"]
    return found


def _section(file: str, name: str) -> dict[str, str]:
    """Return the values of a section; none if the file cannot be read."""
    parser = ConfigParser(interpolation=None, default_section="")
    try:
        parser.read_string(Path(file).expanduser().read_text(encoding="utf-8"))
        return dict(parser[name])
    except (OSError, ValueError, KeyError, RuntimeError, Error):
        return {}
