"""Distance functions over configuration spaces, compressed into kilobytes of planes."""

from plr_jax._box import Box as Box
