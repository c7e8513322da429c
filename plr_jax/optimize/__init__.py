"""Descent along a distance field."""

from plr_jax.optimize._descend import descend as descend
from plr_jax.optimize._descent import Descent as Descent
from plr_jax.optimize._descent import DescentStatus as DescentStatus
