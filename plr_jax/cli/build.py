"""The command ``plr-jax build``: from a map or a volume to a file with a proof."""

import math
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

import plr_jax
from plr_jax.cli import INTERRUPTED_EXIT
from plr_jax.cli.app import command, finish_or_stop, saying
from plr_jax.cli.inputs import (
    DEFAULT_BYTES,
    BoxOption,
    DropSpecksOption,
    EnclosedOption,
    GoalOption,
    MapArgument,
    NamedMap,
    PolygonsOption,
    RadiusOption,
    ResolutionOption,
    ThresholdOption,
    choices,
    is_volume,
    require_writable,
)

if TYPE_CHECKING:
    from plr_jax import PLR, Box, VisibilityGraph
    from plr_jax.spaces import VoxelSpace

_LEAVES = ("best", "plane", "continuous", "smooth", "cone")
_ERROR_POINTS = 20_000
_SPECK = 1e-5  # obstacles of a smaller share of the map's area are called specks


@command(
    "plr-jax build maze -o maze.plr --max-bytes 2048",
    "plr-jax build floor_plan --leaf cone --max-bytes 1024 --leaf-bounds",
    "plr-jax build scan.png --goal 10.5,30 --resolution 0.05 --drop-specks 4 --radius 0.3",
    "plr-jax build cave.3dmap --goal 10.5,30.5,4.5 --max-bytes 16384",
    "plr-jax build hall.stl --goal 1,2,0.5 --resolution 0.1 --enclosed free --radius 0.2",
)
def build(
    map: MapArgument,
    goal: GoalOption = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="The file to write.", show_default="MAP's name with .plr")
    ] = None,
    max_bytes: Annotated[
        int | None,
        typer.Option(help="Largest size of the file.", show_default=f"{DEFAULT_BYTES} if no limit is given"),
    ] = None,
    max_leaves: Annotated[
        int | None,
        typer.Option(help="Largest number of cells; for a volume, of cells to solve on.", show_default=False),
    ] = None,
    max_depth: Annotated[int | None, typer.Option(help="Largest depth of the tree.", show_default=False)] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(
            help="Error (workspace units) at which to stop: the proven error of planes and cones, the sampled error "
            "of other leaves, the estimated mean error of the lower bound for volumes.",
            show_default=False,
        ),
    ] = None,
    leaf: Annotated[
        str,
        typer.Option(
            help="What a cell holds: a 'plane'; 'continuous', a function that does not jump where one can walk; "
            "'smooth', whose gradient does not jump either; 'cone', the distance to the next corner. 'best' compares "
            "them and keeps the least proven error. Volumes have 'continuous' leaves.",
            **choices(_LEAVES),
        ),
    ] = "best",
    leaf_bounds: Annotated[
        bool, typer.Option("--leaf-bounds", help="Prove bounds for every cell, 2 bytes each, not one for all.")
    ] = False,
    seed: Annotated[int, typer.Option(help="Seed of the sample pattern.")] = 0,
    resolution: ResolutionOption = None,
    threshold: ThresholdOption = None,
    drop_specks: DropSpecksOption = None,
    polygons: PolygonsOption = None,
    radius: RadiusOption = None,
    box: BoxOption = None,
    enclosed: EnclosedOption = None,
) -> None:
    """Compress the distance to a goal in a MAP into a small file, with a proof of its largest error.

    In the plane the compressed distance is exact. In volumes it is an estimate, with proven bounds.
    """
    began = time.perf_counter()
    output = output or Path(f"{Path(map).stem}.plr")
    require_writable(output, inputs=(map,))
    if max_bytes is max_leaves is max_depth is None:
        max_bytes = DEFAULT_BYTES
    limits = {"max_leaves": max_leaves, "tolerance": tolerance, "seed": seed}
    named = NamedMap(map, goal, resolution, threshold, drop_specks, polygons, box, enclosed, radius)
    if is_volume(map):
        planar = {"--max-depth": max_depth, "--leaf": None if leaf in ("best", "continuous") else leaf}
        if wrong := [option for option, value in planar.items() if value is not None]:
            raise ValueError(f"{map} is a volume, which is built without {', '.join(wrong)}: leave that out.")
        with saying(f"reading {map}"):
            space, goal_point = named.read_volume()
        plr, interrupted = _build(named, plr_jax.solve_eikonal, space, goal_point, space.domain, max_bytes, limits)
    else:
        if box is not None or enclosed is not None:
            raise ValueError(f"--box and --enclosed are for volumes, and {map} is none: leave them out.")
        oracle, bounds, named = _prepare(named)
        limits |= {"leaf": leaf, "certified": "leaves" if leaf_bounds else True, "max_depth": max_depth}
        plr, interrupted = _build(named, plr_jax.construct, oracle, bounds, bounds, max_bytes, limits)
    seconds = time.perf_counter() - began
    plr_jax.save(plr, output)
    if interrupted:
        typer.echo(f"Interrupted: {output} holds the {plr.num_leaves:,} leaves built so far.", err=True)
        raise typer.Exit(INTERRUPTED_EXIT)
    typer.echo(f"wrote   {output}: {plr.num_bytes:,} bytes; {plr.num_leaves:,} leaves, depth {plr.depth}")
    # Points of another seed than the samples: else the error would be measured where the leaves were fitted.
    if is_volume(map):
        _print_bounds(plr, space, seed + 1)
    else:
        _print_errors(plr, oracle, seed + 1)
    typer.echo(f"time    {seconds:.1f} s to build, {time.perf_counter() - began:.1f} s in all")


def _prepare(named: NamedMap) -> "tuple[VisibilityGraph, Box, NamedMap]":
    """Read a map, and return its exact oracle, its bounds, and the map with its goal named."""
    with saying(f"reading {named.name}"):
        workspace, goal = named.read()
    if goal is None:
        raise ValueError(
            f"{named.name} has no goal of its own, or one for each of several robots: give one with --goal X,Y."
        )
    if named.is_of_pixels():
        import shapely

        parts = np.concatenate([shapely.get_parts(workspace.obstacles), shapely.get_parts(workspace.free_space)])
        small = parts[shapely.area(parts) <= _SPECK * np.prod(workspace.bounds.width)]
        specks = ""
        if len(small):
            count = int(np.sum(shapely.get_num_coordinates(small) - 1))
            specks = (
                f", {count:,} of them of specks ({len(small):,}; --drop-specks N drops those of at most N pixels)"
            )
        typer.echo(f"map     {len(workspace.boundary.vertices):,} vertices{specks}")
    with saying("finding what corners see"):
        oracle = plr_jax.VisibilityGraph(workspace, goal)
    return oracle, workspace.bounds, replace(named, goal=",".join(repr(float(along)) for along in goal))


def _build(
    named: NamedMap,
    function: Callable[..., "PLR"],
    source: Any,
    target: Any,
    domain: "Box",
    max_bytes: int | None,
    options: dict[str, Any],
) -> "tuple[PLR, bool]":
    """Call ``construct(oracle, box)`` or ``solve_eikonal(space, goal)``; label the PLR with its map.

    Returns:
        The PLR, whose file has at most ``max_bytes`` with its label, and whether Ctrl-C ended the work early.
    """
    from plr_jax.plr.container import frame_size, require_label
    from plr_jax.plr.growth import BudgetTooSmall

    require_label(label := str(named))
    label_bytes = frame_size(domain, label=label) - frame_size(domain)
    budget = None if max_bytes is None else max(1, max_bytes - label_bytes)
    try:
        plr, interrupted = finish_or_stop(function, source, target, max_bytes=budget, **options)
    except BudgetTooSmall as error:
        raise ValueError(
            f"--max-bytes {max_bytes} is too small: one leaf takes {error.num_bytes} bytes, the label {label_bytes}; "
            f"allow at least {error.num_bytes + label_bytes}."
        ) from error
    return plr.with_label(label), interrupted


def _print_errors(plr: "PLR", oracle: "VisibilityGraph", seed: int) -> None:
    """Print the proven error, and the error that is measured at random free points."""
    with saying("measuring the error"):
        points = oracle.workspace.sample_free(_ERROR_POINTS, seed)
        report = plr_jax.metrics.error_map(plr.numpy(), oracle, points)
    typer.echo(f"leaf    {plr.leaf.name}: no error above {plr.max_error:.3g}, proven")
    typer.echo(f"error   max {report.max:.3g}, mean {report.mean:.3g} over {report.num_points:,} random free points")
    share = 100 * report.mean / report.max_distance
    typer.echo(f"        mean is {share:.2g} % of the largest distance, {report.max_distance:.4g}")
    if report.num_unreachable:
        typer.echo(f"        {report.num_unreachable:,} of the points cannot reach the goal")
    if report.num_unanswered:
        typer.echo(f"        {report.num_unanswered:,} reachable points got no answer")


def _print_bounds(plr: "PLR", space: "VoxelSpace", seed: int) -> None:
    """Print how far the proven bounds are from the answers, at random free points."""
    rng = np.random.default_rng(seed)
    chosen = rng.choice(np.flatnonzero(space.free), _ERROR_POINTS)
    voxels = np.stack(np.unravel_index(chosen, space.free.shape), axis=1)
    points = space.domain.lo + (voxels + rng.random(voxels.shape)) * space.grid.sides
    reader = plr.numpy()
    answers = reader(points := points[space.is_free(points)])
    points, answers = points[np.isfinite(answers)], answers[np.isfinite(answers)]
    proven = "bounds of every leaf"
    if plr.max_error is not None and math.isfinite(plr.max_error):
        proven = f"no error above {plr.max_error:.3g}"
    typer.echo(f"leaf    continuous: {proven}, proven")
    if not len(points):
        typer.echo("bounds  not sampled: no random point of a free voxel was free and reached the goal")
        return
    lower, upper = reader.bounds(points)
    bounded, total = np.isfinite(upper), f"{len(points):,} random free points that reach the goal"
    if not bounded.any():
        typer.echo(f"bounds  from below alone at all of {total}: allow more --max-bytes or --max-leaves")
        return
    below, above, mean = (part[bounded].mean() for part in (answers - lower, upper - answers, answers))
    at = total if bounded.all() else f"{bounded.sum():,} of {total}"
    typer.echo(f"bounds  {below:.3g} below and {above:.3g} above the answers, {mean:.4g}, in the mean of {at}")
    if not bounded.all():
        typer.echo("        at the others from below alone: more --max-bytes or --max-leaves bound more of them")
