"""Cost-to-go functions computed from free space and motion costs: the eikonal equation on a partition."""

from plr_jax.eikonal.solve import solve_eikonal as solve_eikonal
