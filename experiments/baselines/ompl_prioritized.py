"""Prioritized planning with the Open Motion Planning Library: for one robot after the other, in space and time."""

from experiments.baselines.ompl import task_of, trial
from plr_jax._problem import Problem
from plr_jax.planners._solution import Solution


def ompl_prioritized(
    problem: Problem,
    *,
    seed: int,
    time_limit: float | int,
    cost_target: float | int | None = None,
) -> Solution:
    """Plan for one robot after the other with RRT-Connect of the Open Motion Planning Library (OMPL).

    Each robot gets a path in OMPL's space of position and time, at speeds up to 1, among those that were planned
    for before it, which move along their paths; those still to come are not there. A robot that finds no path in
    its share of the time comes first in the next order, which begins anew. All robots arrive at the same time, a
    horizon: nobody has to find a way around those at rest at their goals, though a path may well rest anywhere.
    Horizons of several lengths are tried in turn. In every other attempt, OMPL's simplifier shortens each path
    before the next robot is planned for.

    From then on, robots are planned for again, each among all others, and their paths simplified, while that helps;
    then another order begins. Replanned robots depart and arrive at random times and rest before and after, where
    they can: without that, all would be on their way, and in each other's, all the time.

    OMPL's distance in space and time, infinite where a robot would be too slow, guides RRT-Connect, with motions of
    at most a fifth of the bounds' longer side; paths are simplified in the product of the plane and the time, with
    nearly all weight on the plane, as OMPL's simplifier needs a metric. A whole motion is tested at once by compiled
    code, exactly. A trial has a process of its own; starting it and compiling (the result is kept on disk) come
    before the clock starts.

    Every path is put through ``validate``. One that fails is dropped with a warning, as if it had not been found.

    Args:
        problem: The problem; its robots are points and discs.
        seed: Seed of all random numbers, from 0 to 2**32 - 2. What is found still varies, as time decides when to
            give up on a robot.
        time_limit: Seconds of planning, positive.
        cost_target: Stop at the first path of at most this cost; None: plan until the time limit.

    Returns:
        The best valid path. Its status is SOLVED if the target was reached; TIME_LIMIT, with or without a path; or
        INTERRUPTED after Ctrl-C, with the best path until then. There are no samples, as each robot has trees of its
        own; the other statistics are those of :func:`~experiments.baselines.ompl.ompl_plan`, motions tested
        being those of single robots.

    Raises:
        ImportError: If OMPL or Numba is not installed.
        ValueError: If a robot is neither a point nor a disc, the seed is out of range, or the time limit or cost
            target is not a positive number.
        RuntimeError: If the worker fails.

    References:
        Erdmann, Lozano-Pérez: On multiple moving objects. Algorithmica 2, 1987.
        Bennewitz, Burgard, Thrun: Finding and optimizing solvable priority schemes for decoupled path planning
        techniques for teams of mobile robots. Robotics and Autonomous Systems 41, 2002.
    """
    for i, robot in enumerate(problem.robots):
        if robot.half_sides is None or robot.half_sides.any():
            raise ValueError(f"ompl_prioritized takes points and discs; robot {i} is {robot!r}.")
    task = task_of(problem, "prioritized RRT-Connect", seed, time_limit, cost_target)
    return trial(task, problem, "ompl_prioritized_worker")
