"""Planning for a problem from its oracles to a checked path, and what is said on the way."""

import time
import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import typer

from plr_jax._problem import Problem, motion_costs
from plr_jax._types import DistanceFn, HeuristicFn
from plr_jax._validate import ValidationReport, validate
from plr_jax.cli._inputs import Heuristic
from plr_jax.oracles import VisibilityGraph, robot_distance_fns
from plr_jax.planners import BLOptions, Solution, Status, bl_plan, straight_line, sum_of_distances, zero
from plr_jax.plr import PLR, ConstructionInterrupted, construct
from plr_jax.robots.robot import Robot


class Phases:
    """Wall-clock seconds of the phases of a command, the first of which began at a time of ``time.perf_counter``."""

    def __init__(self, began: float):
        self._mark = began
        self.seconds: dict[str, float] = {}

    def end(self, name: str) -> None:
        """A phase, begun when the last one ended, ends."""
        now = time.perf_counter()
        self.seconds[name], self._mark = now - self._mark, now


def solve(
    problem: Problem, heuristic: Heuristic, options: BLOptions, max_bytes: int, seed: int, phases: Phases
) -> tuple[Solution, ValidationReport | None]:
    """Plan with a heuristic built on the way, check the path, and print what was built and found.

    The options' lower bound is replaced by :func:`lower_bound`. Returns the solution, and what the independent check
    says about its path if there is one. Ctrl-C before the search raises; later, the solution's status says so.
    """
    typer.echo(f"  robots     {describe(problem.robots)}")
    exact = robot_distance_fns(problem)
    phases.end("oracles")
    function, plrs = heuristic_of(heuristic, problem, exact, max_bytes, seed)
    phases.end("PLRs")
    typer.echo(f"  heuristic  {heuristic}{_of_plrs(plrs, phases.seconds['PLRs'])}")
    bound = lower_bound(problem, exact)
    solution = bl_plan(problem, function, replace(options, lower_bound=bound or None))
    phases.end("planning")
    stats = solution.stats
    typer.echo(f"  status     {solution.status}")
    if solution.status is Status.MEMORY_LIMIT:
        typer.echo(f"  memory     {stats.num_bytes:,} bytes would be needed")
    typer.echo(f"  search     {stats.num_nodes:,} nodes, {stats.num_expansions:,} expansions")
    typer.echo(
        f"             {stats.num_children_scored:,} joint children scored, {stats.num_children_valid:,} valid"
    )
    if solution.path is None:
        typer.echo("  cost       none: no path was found")
        return solution, None
    ratio = f", {solution.cost / bound:.3f} times the lower bound of {bound:.4g}" if bound else ""
    typer.echo(f"  cost       {solution.cost:.4g}{ratio}")
    typer.echo(f"  makespan   {solution.makespan:.4g}")
    report = validate(problem, solution.path)
    phases.end("validation")
    typer.echo(f"  check      {report.message}")
    return solution, report


def heuristic_of(
    heuristic: Heuristic, problem: Problem, exact: Sequence[VisibilityGraph], max_bytes: int, seed: int
) -> tuple[HeuristicFn | None, list[PLR]]:
    """A heuristic by its name, and the PLRs it reads, each once: robots of one size and one goal share theirs."""
    match heuristic:
        case Heuristic.lattice:
            return None, []
        case Heuristic.none:
            return zero(), []
        case Heuristic.straight_line:
            return straight_line(problem), []
        case Heuristic.oracle:
            return sum_of_distances(exact), []
        case Heuristic.point_plr:
            exact = robot_distance_fns(problem, inflated=False)
    plrs: dict[object, PLR] = {}
    # Robots of one size share an oracle's workspace.
    keys = [(id(oracle.workspace), *oracle.goal.tolist()) for oracle in exact]
    for key, oracle in zip(keys, exact, strict=True):
        if key not in plrs:
            plrs[key] = _whole(oracle, problem, max_bytes, seed)
    return sum_of_distances([plrs[key] for key in keys]), list(plrs.values())


def lower_bound(problem: Problem, exact: Sequence[DistanceFn]) -> float:
    """A cost below which there is no path: each robot's, alone, of its way and of its shorter turn to the goal.

    The oracles must never answer more than the way; one that does not know its robot's start counts as straight.
    """
    starts, goals = problem.starts, problem.goals
    ways = np.array([oracle(start[None, :2])[0] for oracle, start in zip(exact, starts, strict=True)])
    straight = np.linalg.norm(goals[:, :2] - starts[:, :2], axis=1)
    ways = np.where(np.isfinite(ways), ways, straight)
    return float((motion_costs(problem, starts, goals) + ways - straight).sum())


def describe(robots: Sequence[Robot]) -> str:
    """A team in words, such as ``2 discs of radius 0.4, 1 point``."""
    return ", ".join(f"{n} {_body(robot, 's' if n > 1 else '')}" for robot, n in Counter(robots).items())


def say_seconds(phases: Phases, solution: Solution) -> None:
    """Print the seconds of all phases, and those of the planner's own."""
    typer.echo(f"  seconds    {sum(phases.seconds.values()):.1f} in all: {_listed(phases.seconds)}")
    typer.echo(f"             planning: {_listed(solution.stats.seconds)}")


def _listed(seconds: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:.2f}" for name, value in seconds.items())


def _of_plrs(plrs: Sequence[PLR], seconds: float) -> str:
    if not plrs:
        return ""
    many = "s" if len(plrs) > 1 else ""
    return f": {len(plrs)} PLR{many}, {sum(plr.num_bytes for plr in plrs):,} bytes, built in {seconds:.1f} s"


def _whole(oracle: VisibilityGraph, problem: Problem, max_bytes: int, seed: int) -> PLR:
    """The PLR of an oracle. Ctrl-C ends the command: nothing is planned with half a PLR."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", ConstructionInterrupted)
        try:
            return construct(oracle, problem.workspace.bounds, max_bytes=max_bytes, seed=seed)
        except ConstructionInterrupted:
            raise KeyboardInterrupt from None


def _body(robot: Robot, plural: str) -> str:
    if len(robot.core) == 1:
        return f"disc{plural} of radius {robot.rounding:g}" if robot.rounding else f"point{plural}"
    kind = f"polygon{plural} of {len(robot.core)} corners" if robot.half_sides is None else f"rectangle{plural}"
    length, width = np.ptp(robot.core, axis=0) + 2 * robot.rounding
    return f"{kind} {length:g} x {width:g}"
