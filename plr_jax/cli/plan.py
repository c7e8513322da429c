"""The command ``plr-jax plan``: plan a path for all robots of a scene, and validate it."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

import plr_jax
from plr_jax.cli.app import command, fail, fail_interrupted
from plr_jax.cli.inputs import PICTURES, SCENES, check_output

_DEFAULT_ROBOTS = {"four_rooms": 4, "cross": 2}
_TEAM_SCENES = ("single_door", *_DEFAULT_ROBOTS, "tangle", *SCENES)


@command(
    "plr-jax plan four_rooms --robots 4 --animation four_rooms.gif",
    "plr-jax plan tangle --output path.json",
    "plr-jax plan four_rooms --robots 3 --cost-factor 1.02 --time-limit 10",
)
def plan(
    scene: Annotated[str, typer.Argument(metavar="SCENE")],
    robots: Annotated[int | None, typer.Option(show_default="4 in four_rooms, 2 in cross")] = None,
    cost_factor: Annotated[float, typer.Option(show_default="stop at the first path")] = math.inf,
    time_limit: float = 60.0,
    output: Annotated[Path | None, typer.Option("--output", "-o")] = None,
    animation: Path | None = None,
    picture: Path | None = None,
) -> None:
    """Plan for all robots of a SCENE at once, check the path, and report.

    Exit code 1: no path was found.

    Args:
        scene: A scene (single_door, four_rooms, cross, tangle, maze, thin_maze, floor_plan), or a scene file (.json).
        robots: Number of robots: 2, 3, 4 or 8 in four_rooms, 2 or 3 in cross.
        cost_factor: Keep searching while the cost exceeds this multiple of the lower bound.
        time_limit: Time limit of planning, in seconds.
        output: Write the solution as JSON; "path" has shape (steps, robots, dof).
        animation: Write an animation of the path: .gif or .html.
        picture: Draw the path: .png, .pdf or .svg.
    """
    # 1. Check all arguments before the work starts.
    check_output(output, (".json",), inputs=(scene,))
    check_output(animation, (".gif", ".html"))
    check_output(picture, PICTURES)
    options = plr_jax.BLOptions(cost_factor=cost_factor, time_limit=time_limit)
    problem = read_problem(scene, robots)
    # 2. Plan, and write the best path, also if planning was interrupted.
    typer.echo(scene)
    solution = solve(problem, options)
    if solution.solved:
        if output is not None:
            solution.save(output)
        if animation is not None:
            plr_jax.plot.animate(problem, solution.path).save(animation)
        if picture is not None:
            plr_jax.plot.save(plr_jax.plot.plot_path(problem, solution.path), picture)
        for file in filter(None, (output, animation, picture)):
            typer.echo(f"  wrote      {file}")
    # 3. Tell by the exit code why there is no path, or not the best one.
    if solution.status is plr_jax.Status.INTERRUPTED:
        fail_interrupted(f"Interrupted: {'the best path so far' if solution.solved else 'no path yet'}.")
    if not solution.solved:
        fail(f"No path: {solution.status}.", code=1)


def read_problem(name: str, num_robots: int | None) -> "plr_jax.Problem":
    """Return the scene of ``plr_jax.scenes`` with this name, or read a scene file whose name ends in ``.json``.

    If ``num_robots`` is None, the scene has its default number of robots.
    """
    if num_robots is not None and name not in _DEFAULT_ROBOTS:
        raise ValueError(f"--robots is for the scenes {' and '.join(_DEFAULT_ROBOTS)}, got {name!r}: leave it out.")
    if name in _DEFAULT_ROBOTS:
        return getattr(plr_jax.scenes, name)(_DEFAULT_ROBOTS[name] if num_robots is None else num_robots)
    if name in _TEAM_SCENES:
        return getattr(plr_jax.scenes, name)()
    if Path(name).suffix == ".json":
        return plr_jax.scenes.load(name)
    raise ValueError(f"SCENE must be a scene ({', '.join(_TEAM_SCENES)}) or a file ending in .json, got {name!r}.")


def solve(
    problem: "plr_jax.Problem", options: "plr_jax.BLOptions", heuristic: "plr_jax.HeuristicFn | None" = None
) -> "plr_jax.Solution":
    """Plan a path, and print a report. If the path found is not valid, the command ends with exit code 1.

    If ``heuristic`` is None, :func:`plr_jax.bl_plan` uses its default. The report compares the path's cost with a
    lower bound: the sum of the robots' exact distances to their goals, each robot alone in the workspace.
    """
    bound = plr_jax.exact_lower_bound(problem)
    solution = plr_jax.bl_plan(problem, heuristic, replace(options, lower_bound=bound if bound < math.inf else 0.0))
    stats = solution.stats
    typer.echo(f"  robots     {len(problem.robots)}")
    typer.echo(f"  status     {solution.status}")
    typer.echo(f"  search     {stats.num_nodes:,} nodes, {stats.num_expansions:,} expansions")
    typer.echo(f"  seconds    {sum(stats.seconds.values()):.2f}")
    if solution.path is None:
        typer.echo("  cost       none: no path was found")
        return solution
    report = plr_jax.validate(problem, solution.path)
    ratio = f"{solution.factor:.3f} times the lower bound of {solution.lower_bound:.4g}"
    typer.echo(f"  cost       {solution.cost:.4g}, {ratio}")
    typer.echo(f"  makespan   {solution.makespan:.4g}")
    typer.echo(f"  check      {report.message}")
    if not report.valid:
        fail(f"The path found is not valid, and was not written: {report.message}", code=1)
    return solution
