"""The command ``plr-jax demo``: compress a maze, compare it with its oracle, and plan for four robots."""

import statistics
import sys
import timeit
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import typer

import plr_jax
from plr_jax import plot, scenes
from plr_jax._types import ArrayLike
from plr_jax.cli import files
from plr_jax.cli.build import build
from plr_jax.cli.inputs import DEFAULT_BYTES
from plr_jax.cli.plan import solve

_MAX_BYTES = 1_024  # of a PLR, as in the README's first example
# Number of points in a batch, and of timed calls: for the PLR, and for the oracle, which is slower.
_PLR_POINTS, _PLR_REPEATS = 1_000_000, 15
_ORACLE_POINTS, _ORACLE_REPEATS = 50_000, 3
_GIF_SECONDS, _GIF_RATE = 6, 10.0  # few frames, since drawing them takes longer than planning


def run(output: Path) -> None:
    """Run the demo: print its results, and write its files to the folder ``output``, which is created if needed."""
    output.mkdir(parents=True, exist_ok=True)
    _maze(output / "maze.plr")
    problem = scenes.four_rooms(4)
    typer.echo("\nFour rooms around a center with narrow doors. Four robots move to the opposite rooms at once.")
    oracles = plr_jax.robot_distance_fns(problem)
    plrs = [plr_jax.construct(oracle, problem.workspace.bounds, max_bytes=_MAX_BYTES) for oracle in oracles]
    typer.echo(f"  heuristic  a PLR for each robot, {sum(plr.num_bytes for plr in plrs):,} bytes in all")
    solution = solve(problem, plr_jax.BLOptions(), plr_jax.sum_of_distances(plrs))
    if solution.status is plr_jax.Status.INTERRUPTED:
        raise KeyboardInterrupt
    animation = plot.animate(problem, solution.path, seconds=_GIF_SECONDS, frames_per_second=_GIF_RATE)
    for file in (output / "four_rooms.html", output / "four_rooms.gif"):
        animation.save(file)
        typer.echo(f"  wrote      {file}   (dashed outlines are goals)")
    pairs = plr_jax.construct_pairs(problem.workspace, max_bytes=DEFAULT_BYTES).with_label("four rooms")
    plot.page(pairs).save(page := output / "four_rooms_distances.html")
    typer.echo(f"  wrote      {page}   (distances between two points that you can drag)")


def _maze(file: Path) -> None:
    """Build, plot and view the distance to a goal in a maze with commands of ``plr-jax``; measure its speed."""
    # 1. Build a PLR, measure its error and write its file, by the command `build`; then load the file.
    problem = scenes.maze()
    workspace, goal = problem.workspace, problem.goals[0]
    typer.echo(f"A maze of six walls. The distances of all points to the goal {tuple(goal.tolist())} go into 1 KB.")
    build("maze", output=file, max_bytes=_MAX_BYTES, leaf="cone")
    plr, oracle = plr_jax.load(file), plr_jax.VisibilityGraph(workspace, goal)
    # 2. Compare the speeds of the PLR and of the oracle.
    points = workspace.sample_free(_PLR_POINTS, seed=1)
    device = jax.devices()[0]
    where = "this machine's CPU" if device.platform == "cpu" else device.device_kind
    typer.echo(f"query   random free points, after compilation, on {where}")
    plr_rate = _rate(plr, jnp.asarray(points, jnp.float32), _PLR_REPEATS)
    oracle_rate = _rate(oracle, points[:_ORACLE_POINTS], _ORACLE_REPEATS)
    typer.echo(f"        PLR           {plr_rate / 1e6:8.1f} million points per second")
    faster = f"the PLR is {plr_rate / oracle_rate:.0f} times as fast"
    typer.echo(f"        exact oracle  {oracle_rate / 1e6:8.1f} million points per second; {faster}")
    # 3. Write pictures, and a page.
    for kind in ("distance", "cells", "error"):
        files.plot(file, file.with_name(f"maze_{kind}.png"), kind=kind)
    typer.echo("        the distance to the goal; cells, each with one next corner of paths; errors of the file")
    files.view(file, output=file.with_suffix(".html"))
    typer.echo("        at the pointer: the distance, its proven bounds, and the path")
    typer.echo(f"try     echo 0.93,0.95 | {sys.argv[0]} query {file} --bounds")


def _rate(function: Callable[[ArrayLike], ArrayLike], points: ArrayLike, repeats: int) -> float:
    """Return how many points per second ``function`` evaluates, from the median time of ``repeats`` calls.

    A first call, which is not timed, compiles the function.
    """
    jax.block_until_ready(function(points))
    seconds = timeit.repeat(lambda: jax.block_until_ready(function(points)), number=1, repeat=repeats)
    return len(points) / statistics.median(seconds)
