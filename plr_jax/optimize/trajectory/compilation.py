"""How the iterations are compiled: hundreds of small operations and their derivatives."""

import functools
from collections.abc import Callable
from typing import Any

import jax

_OPTIONS = {"xla_cpu_use_fusion_emitters": False}


def jit_iterations(iterate: Callable) -> Callable:
    """``jax.jit`` without XLA's slow code generator for fused operations, where this version has a choice."""

    @functools.cache
    def compiled() -> Callable:
        return jax.jit(iterate, compiler_options=_known(_OPTIONS))

    @functools.wraps(iterate)
    def call(*args: Any) -> Any:
        return compiled()(*args)

    return call


def _known(options: dict[str, bool]) -> dict[str, bool]:
    """The options, if this version of XLA knows them."""
    try:
        jax.jit(lambda: 0, compiler_options=options)()
    except jax.errors.JaxRuntimeError:
        return {}
    return options
