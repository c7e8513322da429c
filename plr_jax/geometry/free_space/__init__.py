"""Free space as tables that compiled functions read."""

from plr_jax.geometry.free_space.free_space import FreeSpace, free_space_of

__all__ = ["FreeSpace", "free_space_of"]
