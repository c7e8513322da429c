"""How well the gradient of a distance function points the way."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from plr_jax._arrays import as_booleans, as_finite_point, as_numbers, as_points
from plr_jax._types import ArrayLike, PiecewiseFunction
from plr_jax.geometry.workspace import Workspace

_QUANTILES = (0.5, 0.9, 0.99)
_POINTS_A_FACE = 8
_ASIDE = 2.0**-20  # of the domain: eight times what a query in 32-bit floats resolves
_STEPS_A_SIDE = 4
_SIDES_WALKED = 4

Directions = Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, "n 2"]]
ValuesAndGradients = Callable[[Float[np.ndarray, "n 2"]], tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n 2"]]]


@dataclass(frozen=True)
class JumpReport:
    """Jumps at the free faces of a partition's leaves, in workspace units.

    Attributes:
        max: Largest jump; 0 where there is no face.
        quantiles: Jumps not exceeded by a share 0.5, 0.9 and 0.99 of the points.
        max_at: The point of the largest jump, ``(2,)``; None where there is no face.
        num_points: Points on faces, equally many a leaf and axis, that are free on both sides.
    """

    max: float
    quantiles: dict[float, float]
    max_at: tuple[float, ...] | None
    num_points: int


@dataclass(frozen=True)
class WalkReport:
    """Walks down the gradient from the centers of leaves, each four times its leaf's shorter side long.

    They take steps of a quarter of that side against the gradient, along straight lines.

    Attributes:
        num_leaves: Leaves walked from: those whose center is free and has a way to the goal.
        num_into_wall: Walks that left free space: their gradient leads into a wall.
        num_stalled: Walks that kept clear of walls and ended less than one side from where they began, though not at
            the goal: their gradient leads nowhere.
    """

    num_leaves: int
    num_into_wall: int
    num_stalled: int


@dataclass(frozen=True)
class GradientReport:
    """Gradient of an approximate distance function against the exact direction of travel.

    All fields are plain numbers, fit for JSON. Where two shortest paths are equally long, the exact direction is one
    of two, and the gradient may have chosen the other; such points count like all others.

    Attributes:
        angles: Angles between the negative gradient and the exact direction, in degrees, not exceeded by a share
            0.5, 0.9 and 0.99 of the points that have both.
        max_angle: Largest angle, in degrees.
        max_at: The point of the largest angle, ``(2,)``.
        num_points: Points asked about.
        num_undirected: Points without an exact direction: no way to the goal, or the goal itself.
        num_not_finite: Points with a direction whose gradient or value is not finite. Should be 0.
        num_zero: Points with a direction whose gradient is zero, without those in leaves that hold the goal. Should
            be 0.
        jumps: Jumps at the faces of leaves; None for a function without leaves.
        walks: Walks down the gradient from leaves; None for a function without leaves.
        share_reached: Share of the points with an exact direction from which descent reaches the goal; None where
            no descent was given.
    """

    angles: dict[float, float]
    max_angle: float
    max_at: tuple[float, ...]
    num_points: int
    num_undirected: int
    num_not_finite: int
    num_zero: int
    jumps: JumpReport | None
    walks: WalkReport | None
    share_reached: float | None

    def __str__(self) -> str:
        median, ninety, ninety_nine = (self.angles[q] for q in _QUANTILES)
        lines = [
            f"angle to the exact direction: median {median:.3g}, 90 % {ninety:.3g}, 99 % {ninety_nine:.3g}, "
            f"max {self.max_angle:.3g} degrees over {self.num_points - self.num_undirected:,} points"
        ]
        if self.num_zero or self.num_not_finite:
            lines.append(f"no gradient: zero at {self.num_zero:,} points, not finite at {self.num_not_finite:,}")
        if self.jumps is not None:
            lines.append(f"jumps at free faces: median {self.jumps.quantiles[0.5]:.3g}, max {self.jumps.max:.3g}")
        if self.walks is not None:
            into_wall, stalled, leaves = self.walks.num_into_wall, self.walks.num_stalled, self.walks.num_leaves
            lines.append(f"walks from {leaves:,} leaves: {into_wall:,} lead into a wall, {stalled:,} nowhere")
        if self.share_reached is not None:
            lines.append(f"descent reaches the goal from {self.share_reached:.2%}")
        return "\n".join(lines)


def gradient_report(
    approximation: Callable[[ArrayLike], ArrayLike],
    directions: Directions,
    workspace: Workspace,
    goal: ArrayLike,
    x: ArrayLike,
    *,
    reaches: Callable[[Float[np.ndarray, "n 2"]], Bool[np.ndarray, "n"]] | None = None,
    seed: int = 0,
) -> GradientReport:
    """Measure where the gradient of a distance function points.

    Args:
        approximation: What is judged: a PLR, or any function from points ``(n, 2)`` to ``(n,)`` distances that JAX
            can differentiate. If it has ``leaf_boxes`` and a ``domain``, jumps and walks are reported too.
        directions: The exact directions of travel, unit vectors ``(n, 2)``, zero at the goal and NaN where there is
            no way: ``VisibilityGraph(workspace, goal).directions``.
        workspace: The free space.
        goal: The goal, ``(2,)``.
        x: Where, ``(n, 2)`` free points: ``workspace.sample_free(n, seed)``.
        reaches: Whether descent reaches the goal, for a batch of starts:
            ``lambda x: descend(plr, workspace, x, goal).reached``.
        seed: Seed of the points on faces.

    Returns:
        The report.

    Raises:
        ValueError: If a shape is wrong, no point has both a direction and a gradient, or JAX cannot differentiate the
            function.
    """
    x, goal = as_points("x", x, 2), as_finite_point("The goal", goal, 2)
    evaluate = _differentiated(approximation)
    exact = _directions_at(directions, x)
    directed = np.isfinite(exact).all(axis=1) & (exact != 0).any(axis=1)
    points = x[directed]
    value, gradient = evaluate(points)
    finite = np.isfinite(value) & np.isfinite(gradient).all(axis=1)
    zero = finite & (gradient == 0).all(axis=1)
    usable = finite & ~zero
    if not usable.any():
        raise ValueError(f"Of {len(x)} points none has both an exact direction and a gradient; give free points.")
    angle = _angles(-gradient[usable], exact[directed][usable])
    worst = int(np.argmax(angle))
    leaves = approximation if isinstance(approximation, PiecewiseFunction) else None
    at_goal = np.zeros(len(points), bool) if leaves is None else _in_leaves_of(leaves, points, goal)
    return GradientReport(
        angles={q: float(np.quantile(angle, q)) for q in _QUANTILES},
        max_angle=float(angle[worst]),
        max_at=tuple(map(float, points[usable][worst])),
        num_points=len(x),
        num_undirected=int((~directed).sum()),
        num_not_finite=int((~finite).sum()),
        num_zero=int((zero & ~at_goal).sum()),
        jumps=None if leaves is None else _jump_report(leaves, evaluate, workspace, seed),
        walks=None if leaves is None else _walk_report(leaves, evaluate, workspace, goal, directions),
        share_reached=None if reaches is None else _share_reached(reaches, points),
    )


def _differentiated(distance_fn: Callable[[ArrayLike], ArrayLike]) -> ValuesAndGradients:
    """Values and gradients of a batch. Each value depends on its own point alone, so the sum's gradient has all."""
    import jax
    import jax.numpy as jnp

    def summed(x):
        values = jnp.asarray(distance_fn(x))
        return values.sum(), values

    compiled = jax.jit(jax.value_and_grad(summed, has_aux=True))

    def evaluate(x: Float[np.ndarray, "n 2"]) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n 2"]]:
        try:
            (_, values), gradients = compiled(x)
        except (jax.errors.TracerArrayConversionError, ValueError) as error:
            raise ValueError(
                "JAX cannot differentiate the distance function: perhaps it computes in NumPy, as an oracle does. "
                "Give a PLR, or a function in jax.numpy."
            ) from error
        if values.shape != (len(x),):
            raise ValueError(f"The distance function must give shape ({len(x)},), got {values.shape}.")
        return np.asarray(values, np.float64), np.asarray(gradients, np.float64)

    return evaluate


def _directions_at(directions: Directions, x: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    exact = as_numbers("The exact directions", directions(x), f"numbers of shape {x.shape}")
    if exact.shape != x.shape:
        raise ValueError(f"The exact directions must have shape {x.shape}, got {exact.shape}.")
    return exact


def _share_reached(
    reaches: Callable[[Float[np.ndarray, "n 2"]], Bool[np.ndarray, "n"]], points: Float[np.ndarray, "n 2"]
) -> float:
    return float(as_booleans("reaches", reaches(points), len(points)).mean())


def _angles(u: Float[np.ndarray, "n 2"], v: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n"]:
    """Angles between vectors in degrees, precise for small ones and for those close to a half turn (Kahan)."""
    u, v = _unit_vectors(u), _unit_vectors(v)
    return np.degrees(2 * np.arctan2(np.linalg.norm(u - v, axis=1), np.linalg.norm(u + v, axis=1)))


def _unit_vectors(v: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Vectors of length one; NaN where there is no direction."""
    length = np.linalg.norm(v, axis=1, keepdims=True)
    usable = np.isfinite(length) & (length > 0)
    return np.divide(v, length, out=np.full_like(v, np.nan), where=usable)


def _corners(leaves: PiecewiseFunction) -> tuple[Float[np.ndarray, "leaves 2"], Float[np.ndarray, "leaves 2"]]:
    lo, hi = leaves.leaf_boxes
    return np.asarray(lo, np.float64), np.asarray(hi, np.float64)


def _in_leaves_of(
    leaves: PiecewiseFunction, x: Float[np.ndarray, "n 2"], goal: Float[np.ndarray, "2"]
) -> Bool[np.ndarray, "n"]:
    """Whether points are in a closed leaf that holds the goal."""
    inside = np.zeros(len(x), bool)
    lo, hi = _corners(leaves)
    for leaf in np.flatnonzero(((lo <= goal) & (goal <= hi)).all(axis=1)):
        inside |= ((lo[leaf] <= x) & (x <= hi[leaf])).all(axis=1)
    return inside


def _jump_report(
    leaves: PiecewiseFunction, evaluate: ValuesAndGradients, workspace: Workspace, seed: int
) -> JumpReport:
    """Differences of the values carried on to the faces by the gradients beside them, where both are finite."""
    face, step = _free_faces(leaves, workspace, seed)
    (below, slope_below), (above, slope_above) = evaluate(face - step), evaluate(face + step)
    both = np.isfinite(below) & np.isfinite(above)
    rise = (step * (slope_below + slope_above)).sum(axis=1)
    jumps, at = np.abs(above[both] - below[both] - rise[both]), face[both]
    if len(jumps) == 0:
        return JumpReport(0.0, dict.fromkeys(_QUANTILES, 0.0), None, 0)
    worst = int(np.argmax(jumps))
    quantiles = {q: float(np.quantile(jumps, q)) for q in _QUANTILES}
    return JumpReport(float(jumps[worst]), quantiles, tuple(map(float, at[worst])), len(jumps))


def _free_faces(
    leaves: PiecewiseFunction, workspace: Workspace, seed: int
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"]]:
    """Points drawn on the upper faces of each leaf, free on both sides, and small steps across."""
    lo, hi = _corners(leaves)
    rng, domain = np.random.default_rng(seed), leaves.domain
    points, aside = [np.empty((0, 2))], [np.empty((0, 2))]
    for axis in range(2):
        inner = hi[:, axis] < domain.hi[axis]
        share = rng.random((_POINTS_A_FACE, inner.sum(), 2))
        share[..., axis] = 1.0
        points.append((lo[inner] + share * (hi - lo)[inner]).reshape(-1, 2))
        aside.append(np.tile(np.eye(2)[axis] * _ASIDE * domain.width[axis], (len(points[-1]), 1)))
    face, step = np.concatenate(points), np.concatenate(aside)
    free = workspace.is_visible(face - step, face + step)
    return face[free], step[free]


def _walk_report(
    leaves: PiecewiseFunction,
    evaluate: ValuesAndGradients,
    workspace: Workspace,
    goal: Float[np.ndarray, "2"],
    directions: Directions,
) -> WalkReport:
    """Walk from the centers that have a way, until within a step of the goal or where a step leaves free space."""
    lo, hi = _corners(leaves)
    center, side = (lo + hi) / 2, (hi - lo).min(axis=1)
    start = np.isfinite(_directions_at(directions, center)).all(axis=1)
    center, side = center[start], side[start]
    at, step = center.copy(), side[:, None] / _STEPS_A_SIDE
    walled, home = np.zeros((2, len(center)), bool)
    for _ in range(_STEPS_A_SIDE * _SIDES_WALKED):
        home |= np.linalg.norm(at - goal, axis=1) <= step[:, 0]
        onward = at + step * _unit_vectors(-evaluate(at)[1])
        moves = ~home & ~walled & np.isfinite(onward).all(axis=1)
        walled[moves] = ~workspace.is_visible(at[moves], onward[moves])
        moves &= ~walled
        at[moves] = onward[moves]
    stalled = ~home & ~walled & (np.linalg.norm(at - center, axis=1) < side)
    return WalkReport(len(walled), int(walled.sum()), int(stalled.sum()))
