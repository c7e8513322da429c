"""Distance functions straight from what is free and what a step costs: the eikonal equation on a partition."""

from plr_jax.eikonal.solve import solve_eikonal as solve_eikonal
