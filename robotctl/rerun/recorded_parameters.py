"""Compares the parameters of a kernel with those that the metadata of its recording names."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from robotctl.config import Config, flat
from robotctl.config.settings import keyed_leaves
from robotctl.kernel.params import KernelParams


def differing_parameters(noted: Mapping[str, str], params: KernelParams) -> Iterator[str]:
    """Yield a sentence for each parameter that the kernel began with and `noted` contradicts.

    `noted` is what the first file of a recording tells of the daemon that began with it.
    """
    config = Config(kernel=params)
    values = flat(config)
    for key, leaf in keyed_leaves(config):
        theirs = noted.get(f"parameter.{key}")
        if leaf.path[0] == "kernel" and theirs is not None and theirs != str(values[key]):
            yield (
                f"the journal begins with {key} {values[key]}, and the metadata says {theirs[:80]}"
            )
