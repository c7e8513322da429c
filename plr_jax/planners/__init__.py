"""The team planner, its heuristics, and replanning while the goals or the map change."""

from plr_jax.planners._heuristics import straight_line as straight_line
from plr_jax.planners._heuristics import sum_of_distances as sum_of_distances
from plr_jax.planners._heuristics import zero as zero
from plr_jax.planners._solution import Solution as Solution
from plr_jax.planners._solution import Stats as Stats
from plr_jax.planners._solution import Status as Status
from plr_jax.planners.driver import bl_plan as bl_plan
from plr_jax.planners.replanning import LifelongRun as LifelongRun
from plr_jax.planners.replanning import lifelong as lifelong
from plr_jax.planners.replanning import replan as replan
from plr_jax.planners.searches import BLOptions as BLOptions
