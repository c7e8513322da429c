"""What ``plr-jax build`` makes of a volume: a PLR with bounds of every leaf, by no oracle."""

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import typer
from jaxtyping import Bool, Float

from plr_jax.cli import INTERRUPTED_EXIT
from plr_jax.cli._app import saying
from plr_jax.cli._inputs import numbers_of, parse_goal
from plr_jax.cli._maps import command_text, option_of

if TYPE_CHECKING:
    from plr_jax.geometry.box import Box
    from plr_jax.plr import PLR, NumpyPLR
    from plr_jax.spaces import VoxelSpace

VOLUME_LEAVES = ("best", "continuous")
_ERROR_POINTS = 20_000
_ENCLOSED = {None: True, "blocked": True, "free": False}
"""Whether what a mesh encloses is filled."""


def is_volume(name: str) -> bool:
    """Whether MAP is a file of a volume, by its ending."""
    from plr_jax.scenes._volumes import VOLUME_ENDINGS

    return Path(name).suffix.lower() in VOLUME_ENDINGS


@dataclass(frozen=True)
class NamedVolume:
    """A volume as a command names it. As text it is a part of a command line.

    Attributes:
        name: The file.
        goal: ``X,Y,Z``, or as many coordinates as the volume has axes.
        resolution: Side of a voxel; None: 1.
        box: Corners of the box that the voxels fill; None: from 0 on, or the mesh's bounding box.
        enclosed: Whether what a mesh encloses is ``blocked`` or ``free``; None: blocked.
        radius: Of a ball whose center's distance is meant; None: that of a point.
    """

    name: str
    goal: str | None = None
    resolution: float | None = None
    box: str | None = None
    enclosed: str | None = None
    radius: float | None = None

    def __str__(self) -> str:
        return command_text(**vars(self))

    def read(self) -> tuple["VoxelSpace", Float[np.ndarray, "dim"]]:
        """The space and the goal; ``ValueError`` if the file is no volume or has no such options."""
        from plr_jax.scenes._volumes import is_mesh
        from plr_jax.spaces import VoxelSpace

        free, bounds = self._read_mesh() if is_mesh(self.name) else self._read_voxels()
        if self.goal is None:
            names = ",".join("XYZW"[: free.ndim])
            raise ValueError(f"{self.name} has no goal of its own: give one with --goal {names}.")
        return VoxelSpace(free, bounds, self.radius or 0.0), parse_goal(self.goal, free.ndim)

    def _read_mesh(self) -> tuple[Bool[np.ndarray, "x y z"], "Box"]:
        from plr_jax.scenes._volumes import volume_of

        if self.resolution is None:
            raise ValueError(f"{self.name} is a mesh: give the side of a voxel with --resolution.")
        if self.enclosed not in _ENCLOSED:
            raise ValueError(f"--enclosed must be blocked or free, got {self.enclosed!r}.")
        try:
            free, bounds = volume_of(self.name, self.resolution, self._given_box(), _ENCLOSED[self.enclosed])
        except ImportError as error:
            raise ValueError(str(error)) from error
        if not free.any():
            raise ValueError(
                f"{self.name} leaves no voxel free: --enclosed free leaves those that its surface encloses, a larger "
                "--box those around it."
            )
        return free, bounds

    def _read_voxels(self) -> tuple[Bool[np.ndarray, "..."], "Box"]:
        from plr_jax.geometry.box import Box
        from plr_jax.scenes._volumes import volume_of

        box = self._given_box()
        if self.enclosed is not None:
            raise ValueError(f"{self.name} is an array of voxels, which encloses nothing: leave out --enclosed.")
        if self.resolution is not None and box is not None:
            raise ValueError("--box says how large voxels are: leave out --resolution.")
        free, bounds = volume_of(self.name, None, None, True)
        side = 1.0 if self.resolution is None else self.resolution
        return free, Box(bounds.lo, side * bounds.hi) if box is None else box

    def _given_box(self) -> "Box | None":
        from plr_jax.geometry.box import Box

        if self.box is None:
            return None
        corners = numbers_of(self.box)
        if not corners or len(corners) % 2:
            raise ValueError(
                f"--box must be two corners X,Y,Z,X,Y,Z in one argument, such as 0,0,0,4,3,2, got {self.box!r}."
            )
        return Box.of(np.reshape(corners, (2, -1)), "--box")


def build_volume(
    named: NamedVolume, output: Path, *, max_bytes: int | None, others: Mapping[str, Any], **limits: Any
) -> None:
    """Write the PLR of a volume, and say what is proven of it.

    Args:
        named: The volume and the goal.
        output: The file to write.
        max_bytes: Most bytes of it, with the label.
        others: Options that are for other maps, by their names; ``ValueError`` if one is given.
        **limits: The others of :func:`solve_eikonal`.
    """
    began = time.perf_counter()
    if wrong := [option_of(name) for name, value in others.items() if value is not None]:
        raise ValueError(f"{named.name} is a volume, which is built without {', '.join(wrong)}: leave that out.")
    from plr_jax._atomic import write_atomically
    from plr_jax.plr import NumpyPLR
    from plr_jax.plr.file.container import require_label

    require_label(label := str(named))
    with saying(f"reading {named.name}"):
        space, goal = named.read()
    plr, interrupted = _solved(space, goal, label, max_bytes, limits)
    data = plr.to_bytes()
    write_atomically(output, data)
    if interrupted:
        typer.echo(f"Interrupted: {output} holds the {plr.num_leaves:,} leaves built so far.", err=True)
        raise typer.Exit(INTERRUPTED_EXIT)
    typer.echo(f"wrote   {output}: {len(data):,} bytes; {plr.num_leaves:,} leaves, depth {plr.depth}")
    _say_bounds(NumpyPLR(data), _free_points(space, limits["seed"] + 1))
    typer.echo(f"time    {time.perf_counter() - began:.1f} s")


def _solved(
    space: "VoxelSpace", goal: Float[np.ndarray, "dim"], label: str, max_bytes: int | None, limits: dict[str, Any]
) -> tuple["PLR", bool]:
    """The PLR with its label, and whether it was interrupted."""
    from plr_jax.eikonal import solve_eikonal
    from plr_jax.plr._best import constructed
    from plr_jax.plr.file.container import frame_size
    from plr_jax.plr.growth.limits import BudgetTooSmall

    taken = frame_size(space.domain, label=label) - frame_size(space.domain)
    budget = None if max_bytes is None else max(1, max_bytes - taken)
    try:
        plr, interrupted = constructed(solve_eikonal, space, goal, max_bytes=budget, **limits)
    except BudgetTooSmall as error:
        raise ValueError(
            f"--max-bytes {max_bytes} is too small: one leaf takes {error.num_bytes} bytes, the label {taken}; allow "
            f"at least {error.num_bytes + taken}."
        ) from error
    return plr.with_label(label), interrupted


def _free_points(space: "VoxelSpace", seed: int) -> Float[np.ndarray, "n dim"]:
    """Random free points, in random free voxels."""
    rng = np.random.default_rng(seed)
    chosen = rng.choice(np.flatnonzero(space.free), _ERROR_POINTS)
    voxels = np.stack(np.unravel_index(chosen, space.free.shape), axis=1)
    points = space.domain.lo + (voxels + rng.random(voxels.shape)) * space.grid.sides
    return points[space.is_free(points)]


def _say_bounds(plr: "NumpyPLR", points: Float[np.ndarray, "n dim"]) -> None:
    """Print how far the proven bounds are from what is answered."""
    answers = plr(points)
    points, answers = points[np.isfinite(answers)], answers[np.isfinite(answers)]
    lower, upper = plr.bounds(points)
    is_bounded, total = np.isfinite(upper), f"{len(points):,} random free points that reach the goal"
    error = math.inf if plr.max_error is None else plr.max_error
    proven = f"no error above {error:.3g}" if math.isfinite(error) else "bounds of every leaf"
    typer.echo(f"leaf    continuous: {proven}, proven")
    if not len(points):
        typer.echo("bounds  not sampled: no random point of a free voxel was free and reached the goal")
        return
    if not is_bounded.any():
        typer.echo(f"bounds  from below alone at all of {total}: allow more --max-bytes or --max-leaves")
        return
    below, above, mean = (part[is_bounded].mean() for part in (answers - lower, upper - answers, answers))
    at = f"{is_bounded.sum():,} of {total}" if not is_bounded.all() else total
    typer.echo(f"bounds  {below:.3g} below and {above:.3g} above the answers, {mean:.4g}, in the mean of {at}")
    if not is_bounded.all():
        typer.echo("        at the others from below alone: more --max-bytes or --max-leaves bound more of them")
