"""Cost-to-go functions computed from free space and motion costs, as solutions of the eikonal equation."""

from plr_jax.eikonal.solve import solve_eikonal as solve_eikonal
