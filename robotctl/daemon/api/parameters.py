"""The methods of the control socket for the parameters."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from robotctl.base.errors import Refused
from robotctl.config import Config, flat
from robotctl.daemon.parameters import Parameters, listed
from robotctl.ipc.advice import advice
from robotctl.ipc.answers import ParameterList, ParameterSet
from robotctl.ipc.method_names import PARAM_LIST, PARAM_SET
from robotctl.ipc.method_params import NoParams, ParamSetParams
from robotctl.ipc.request_handler import Method


def list_method(config: Callable[[], Config]) -> dict[str, Method[Any]]:
    """Return a table with the method `param_list`; `config()` is the present configuration."""

    async def get_list(_: NoParams) -> ParameterList:
        return {"parameters": listed(config())}

    return {PARAM_LIST: Method(NoParams, get_list)}


def parameter_methods(parameters: Parameters, robot: str) -> dict[str, Method[Any]]:
    """Return `param_list` and `param_set`; error texts suggest commands for `robot`."""

    async def set_one(params: ParamSetParams) -> ParameterSet:
        setting = parameters.parsed(params.key, params.value)
        old = _value(parameters, params.key)
        reply = parameters.request([setting], params.source)
        if not reply.ok:
            raise Refused(*advice(reply.message, reply.remedies, robot))
        return {
            "message": reply.message,
            "key": params.key,
            "old": old,
            "new": _value(parameters, params.key),
        }

    return {
        **list_method(lambda: parameters.config),
        PARAM_SET: Method(ParamSetParams, set_one),
    }


def _value(parameters: Parameters, key: str) -> Any:
    return flat(parameters.config)[key]
