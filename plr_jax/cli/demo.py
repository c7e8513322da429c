"""The command ``plr-jax demo``: compress a maze, compare it with its oracle, and plan for four robots."""

import statistics
import time
import timeit
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import typer

import plr_jax
from plr_jax import PLR, Workspace, construct, metrics, plot, scenes
from plr_jax._types import ArrayLike, DistanceFn
from plr_jax.cli.inputs import DEFAULT_BYTES
from plr_jax.cli.plan import solve

# Number of points in a batch, and of timed calls: for the PLR, and for the oracle, which is slower.
_PLR_POINTS, _PLR_REPEATS = 1_000_000, 15
_ORACLE_POINTS, _ORACLE_REPEATS = 100_000, 3
_CONE_BYTES = 1024  # size limit of the file in the page
_GIF_SECONDS, _GIF_RATE = 6, 12.5  # few frames, since drawing them takes longer than planning


def run(output: Path) -> None:
    """Run the demo: print its results, and write its files to the folder ``output``, which is created if needed."""
    output.mkdir(parents=True, exist_ok=True)
    _maze(output)
    problem = scenes.four_rooms(4)
    typer.echo("Four rooms around a center with narrow doors; four robots move to the opposite rooms at once.")
    oracles = plr_jax.robot_distance_fns(problem)
    plrs = [construct(oracle, problem.workspace.bounds, max_bytes=DEFAULT_BYTES) for oracle in oracles]
    typer.echo(f"  heuristic  {len(plrs)} PLRs, {sum(plr.num_bytes for plr in plrs):,} bytes")
    solution = solve(problem, plr_jax.BLOptions(), plr_jax.sum_of_distances(plrs))
    if solution.status is plr_jax.Status.INTERRUPTED:
        raise KeyboardInterrupt
    animation = plot.animate(problem, solution.path, seconds=_GIF_SECONDS, frames_per_second=_GIF_RATE)
    for file in (output / "four_rooms.html", output / "four_rooms.gif"):
        animation.save(file)
        typer.echo(f"  wrote      {file}")
    pairs = plr_jax.construct_pairs(problem.workspace, max_bytes=DEFAULT_BYTES).with_label("four rooms")
    plot.page(pairs).save(page := output / "four_rooms_distances.html")
    typer.echo(f"  wrote      {page}   (drag either end)")


def _maze(output: Path) -> None:
    """Compress the distance to a goal in a maze; report size, error and speed; draw it."""
    # 1. Construct and save the PLR.
    problem = scenes.maze()
    workspace, goal = problem.workspace, problem.goals[0]
    typer.echo(f"A maze of six walls, and the distance from any point to {tuple(goal.tolist())}, to be compressed.")
    began = time.perf_counter()
    oracle = plr_jax.VisibilityGraph(workspace, goal)
    plr = construct(oracle, workspace.bounds, max_bytes=DEFAULT_BYTES)
    seconds = time.perf_counter() - began
    plr_jax.save(plr, output / "maze.plr")
    typer.echo(f"  built   {plr.num_leaves} planes in {seconds:.1f} s")
    typer.echo(f"  size    {plr.num_bytes:,} bytes in the file, {plr.resident_bytes:,} in memory")
    # 2. Compare it with the exact distance.
    points = workspace.sample_free(_PLR_POINTS, seed=1)
    report = metrics.error_map(plr, oracle, points[:_ORACLE_POINTS])
    sample = f"{report.num_points:,} random free points (distances reach {report.max_distance:.2f})"
    typer.echo(f"  error   max {report.max:.4f}, mean {report.mean:.4f} over {sample}")
    device = jax.devices()[0]
    where = "this machine's CPU" if device.platform == "cpu" else device.device_kind
    typer.echo(f"  query   a batch of random free points, after compilation, on {where}")
    plr_rate = _rate(plr, jnp.asarray(points, jnp.float32), _PLR_REPEATS)
    oracle_rate = _rate(oracle, points[:_ORACLE_POINTS], _ORACLE_REPEATS)
    typer.echo(f"          PLR           {plr_rate / 1e6:8.1f} million points per second")
    typer.echo(f"          exact oracle  {oracle_rate / 1e6:8.1f} million points per second")
    typer.echo(f"          PLR / oracle  {plr_rate / oracle_rate:8.0f} times")
    # 3. Write pictures, and a page.
    _draw(plr, oracle, workspace, goal, output)
    cones = construct(oracle, workspace.bounds, leaf="cone", max_bytes=_CONE_BYTES, certified=True)
    plot.page(cones.with_label("maze"), workspace).save(page := output / "maze.html")
    typer.echo(f"  wrote   {page}   (open it in a browser: the distance as {cones.num_bytes:,} bytes of cones)")
    typer.echo(f"  wrote   {output / 'maze.plr'}   (try: plr-jax query {output / 'maze.plr'})")


def _rate(function: Callable[[ArrayLike], ArrayLike], points: ArrayLike, repeats: int) -> float:
    """Return how many points per second ``function`` evaluates, from the median time of ``repeats`` calls.

    One more call before these compiles the function.
    """
    jax.block_until_ready(function(points))
    seconds = timeit.repeat(lambda: jax.block_until_ready(function(points)), number=1, repeat=repeats)
    return len(points) / statistics.median(seconds)


def _draw(plr: PLR, oracle: DistanceFn, workspace: Workspace, goal: ArrayLike, output: Path) -> None:
    distance = plot.plot_contours(plr, workspace=workspace, goal=goal)
    plot.plot_cells(plr, distance, color="white")
    pictures = {
        "distance": distance,
        "error": plot.plot_error(metrics.error_grid(plr, oracle, workspace), workspace),
        "surface": plot.plot_surface(plr, workspace=workspace),
    }
    for name, ax in pictures.items():
        plot.save(ax, path := output / f"maze_{name}.png")
        typer.echo(f"  wrote   {path}")
