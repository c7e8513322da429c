"""The command ``plr-jax plan``: plan a path for all robots of a scene, and validate it."""

import time
import warnings
from collections import Counter
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from plr_jax.cli import INTERRUPTED_EXIT
from plr_jax.cli.app import command, fail
from plr_jax.cli.inputs import DEFAULT_BYTES, PICTURES, SCENES, require_writable

if TYPE_CHECKING:
    from plr_jax import BLOptions, HeuristicFn, Problem, Robot, Solution, ValidationReport, VisibilityGraph

_TEAM_SCENES = ("single_door", "four_rooms", "cross", "tangle", *SCENES)
_DEFAULT_ROBOTS = {"four_rooms": 4, "cross": 2}


class Heuristic(StrEnum):
    lattice = "lattice"
    none = "none"
    straight_line = "straight-line"
    point_plr = "point-plr"
    plr = "plr"
    oracle = "oracle"


@command(
    "plr-jax plan four_rooms --robots 4 --animation four_rooms.gif",
    "plr-jax plan tangle --heuristic oracle --output path.json",
    "plr-jax plan four_rooms --robots 3 --cost-factor 1.02 --time-limit 10",
)
def plan(
    scene: Annotated[
        str,
        typer.Argument(
            metavar="SCENE", help=f"A scene ({', '.join(_TEAM_SCENES)}), or a scene file (.json).", show_default=False
        ),
    ],
    robots: Annotated[
        int | None,
        typer.Option(
            help="Number of robots: 2, 3, 4 or 8 in four_rooms, 2 or 3 in cross.",
            show_default="4 in four_rooms, 2 in cross",
        ),
    ] = None,
    heuristic: Annotated[
        Heuristic,
        typer.Option(
            help="Cost-to-go of each robot: along its lattice; none; a straight line; a PLR for a point robot, as in "
            "the paper; a PLR for obstacles inflated by its radius; or the exact distance that this PLR compresses."
        ),
    ] = Heuristic.lattice,
    plr_bytes: Annotated[int, typer.Option(help="Largest size of each PLR.")] = DEFAULT_BYTES,
    step: Annotated[
        float | None,
        typer.Option(help="Cell size of the lattices, in workspace units.", show_default="automatic, then refined"),
    ] = None,
    weight: Annotated[
        float | None,
        typer.Option(help="Weight of the heuristic; larger is greedier.", show_default="by the number of robots"),
    ] = None,
    cost_factor: Annotated[
        float | None,
        typer.Option(
            help="Keep searching while the cost exceeds this multiple of the lower bound.",
            show_default="stop at the first path",
        ),
    ] = None,
    time_limit: Annotated[float, typer.Option(help="Time limit of planning, in seconds.")] = 60.0,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help='Write the solution as JSON; "path" has shape (steps, robots, dof).'),
    ] = None,
    animation: Annotated[Path | None, typer.Option(help="Write an animation of the path: .gif or .html.")] = None,
    picture: Annotated[Path | None, typer.Option(help="Draw the path: .png, .pdf or .svg.")] = None,
) -> None:
    """Plan for all robots of a SCENE at once, check the path, and report.

    Exit code 1: no path was found.
    """
    require_writable(output, (".json",), inputs=(scene,))
    require_writable(animation, (".gif", ".html"))
    require_writable(picture, PICTURES)
    from plr_jax import BLOptions, Status
    from plr_jax import plot as draw

    given = {"step": step, "heuristic_weight": weight, "cost_factor": cost_factor, "time_limit": time_limit}
    options = BLOptions(**{key: value for key, value in given.items() if value is not None})  # type: ignore[reportArgumentType]
    problem = _read_problem(scene, robots)
    typer.echo(scene)
    solution, report = solve(problem, heuristic, options, plr_bytes)
    if report is not None and report.valid:
        if output is not None:
            solution.save(output)
        if animation is not None:
            draw.animate(problem, solution.path).save(animation)
        if picture is not None:
            draw.save(draw.plot_path(problem, solution.path), picture)
        for file in (output, animation, picture):
            if file is not None:
                typer.echo(f"  wrote      {file}")
    if report is not None and not report.valid:
        fail(f"The path found is not valid, and was not written: {report.message}", code=1)
    if solution.status is Status.INTERRUPTED:
        typer.echo(f"Interrupted: {'the best path so far' if solution.solved else 'no path yet'}.", err=True)
        raise typer.Exit(INTERRUPTED_EXIT)
    if not solution.solved:
        fail(f"No path: {solution.status}.", code=1)


def _read_problem(name: str, num_robots: int | None) -> "Problem":
    from plr_jax import scenes

    if num_robots is not None and name not in _DEFAULT_ROBOTS:
        raise ValueError(f"--robots is for the scenes {' and '.join(_DEFAULT_ROBOTS)}, got {name!r}: leave it out.")
    if name in _DEFAULT_ROBOTS:
        return getattr(scenes, name)(_DEFAULT_ROBOTS[name] if num_robots is None else num_robots)
    if name in _TEAM_SCENES:
        return getattr(scenes, name)()
    if Path(name).suffix == ".json":
        return scenes.load(name)
    raise ValueError(f"SCENE must be a scene ({', '.join(_TEAM_SCENES)}) or a file ending in .json, got {name!r}.")


def solve(
    problem: "Problem", heuristic: Heuristic, options: "BLOptions", max_bytes: int
) -> "tuple[Solution, ValidationReport | None]":
    """Build a heuristic, plan with it, validate the path, and print a report; Ctrl-C may leave a partial solution."""
    from dataclasses import replace

    from plr_jax import bl_plan, robot_distance_fns, sum_of_distances, validate

    seconds, began = {}, time.perf_counter()
    typer.echo(f"  robots     {describe(problem.robots)}")
    exact = robot_distance_fns(problem)
    bound = float(sum_of_distances(exact)(problem.starts[None])[0])
    bound = bound if np.isfinite(bound) else 0.0
    seconds["oracles"], began = time.perf_counter() - began, time.perf_counter()
    function, plrs = _build_heuristic(heuristic, problem, exact, max_bytes)
    seconds["PLRs"], began = time.perf_counter() - began, time.perf_counter()
    built = f": {len(plrs)} PLR{'s' * (len(plrs) > 1)}, {sum(plr.num_bytes for plr in plrs):,} bytes" if plrs else ""
    typer.echo(f"  heuristic  {heuristic}{built}")
    solution = bl_plan(problem, function, replace(options, lower_bound=bound or None))
    seconds["planning"], began = time.perf_counter() - began, time.perf_counter()
    stats, report = solution.stats, None
    typer.echo(f"  status     {solution.status}")
    typer.echo(f"  search     {stats.num_nodes:,} nodes, {stats.num_expansions:,} expansions")
    if solution.path is None:
        typer.echo("  cost       none: no path was found")
    else:
        ratio = f", {solution.cost / bound:.3f} times the lower bound of {bound:.4g}" if bound else ""
        typer.echo(f"  cost       {solution.cost:.4g}{ratio}")
        typer.echo(f"  makespan   {solution.makespan:.4g}")
        report = validate(problem, solution.path)
        seconds["validation"] = time.perf_counter() - began
        typer.echo(f"  check      {report.message}")
    parts = ", ".join(f"{name} {value:.2f}" for name, value in seconds.items())
    typer.echo(f"  seconds    {sum(seconds.values()):.1f} in all: {parts}")
    return solution, report


def _build_heuristic(
    heuristic: Heuristic, problem: "Problem", exact: Sequence["VisibilityGraph"], max_bytes: int
) -> "tuple[HeuristicFn | None, list[Any]]":
    """Return a heuristic and its PLRs, which robots of equal size and goal share; None for the planner's default."""
    from plr_jax import construct, robot_distance_fns, straight_line, sum_of_distances, zero
    from plr_jax.plr import ConstructionInterrupted

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
    plrs: dict[object, Any] = {}
    # Robots of equal size share a workspace.
    keys = [(id(oracle.workspace), *oracle.goal.tolist()) for oracle in exact]
    for key, oracle in zip(keys, exact, strict=True):
        if key not in plrs:
            with warnings.catch_warnings():
                warnings.simplefilter("error", ConstructionInterrupted)
                try:
                    plrs[key] = construct(oracle, problem.workspace.bounds, max_bytes=max_bytes)
                except ConstructionInterrupted:  # do not plan with an incomplete PLR
                    raise KeyboardInterrupt from None
    return sum_of_distances([plrs[key] for key in keys]), list(plrs.values())


def describe(robots: Sequence["Robot"]) -> str:
    """Return a description of a team, such as ``2 discs of radius 0.4, 1 point``."""
    return ", ".join(f"{n} {_body(robot, 's' if n > 1 else '')}" for robot, n in Counter(robots).items())


def _body(robot: "Robot", plural: str) -> str:
    if len(robot.core) == 1:
        return f"disc{plural} of radius {robot.rounding:g}" if robot.rounding else f"point{plural}"
    kind = f"polygon{plural} of {len(robot.core)} corners" if robot.half_sides is None else f"rectangle{plural}"
    length, width = np.ptp(robot.core, axis=0) + 2 * robot.rounding
    return f"{kind} {length:g} x {width:g}"
