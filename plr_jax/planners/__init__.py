"""Use distance: heuristics, the Barraquand-Latombe planner, and planners to compare it with."""

from plr_jax.planners._solution import Solution as Solution
from plr_jax.planners._solution import Stats as Stats
from plr_jax.planners._solution import Status as Status
