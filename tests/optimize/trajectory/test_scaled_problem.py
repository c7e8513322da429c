import jax
import jax.numpy as jnp
import pytest

from plr_jax.optimize.trajectory import scaled_problem as compilation
from plr_jax.optimize.trajectory.scaled_problem import jit_iterations


@pytest.mark.parametrize("option", ["xla_cpu_use_fusion_emitters", "xla_cpu_of_another_version"])
def test_iterations_are_compiled_whether_or_not_xla_knows_the_option(option, monkeypatch):
    monkeypatch.setattr(compilation, "_OPTIONS", {option: False})
    traced = []

    @jit_iterations
    def iterate(x):
        traced.append(x)
        return jnp.sin(x) + 1

    assert iterate.__name__ == "iterate"
    assert iterate(jnp.float32(0)) == iterate(jnp.float32(0)) == 1
    assert len(traced) == 1 and isinstance(traced[0], jax.core.Tracer)
