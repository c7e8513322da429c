"""Refinement: the partition of a PLR stays, and the functions of all leaves move at once against a loss."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from plr_jax._arrays import as_number, as_numbers, as_points, require_integer, shortened, with_inf_for_masked
from plr_jax._types import ArrayLike, Distances, Points
from plr_jax.plr._plr import PLR, leaf_of, with_stored
from plr_jax.plr.leaves.base import as_linear
from plr_jax.plr.refinement.objective import Faces, Loss, Penalty, minimize, squared
from plr_jax.plr.refinement.scaled_problem import WeightedPoints, pose

# What a refinement gained: errors of a PLR over points, before and after.


@dataclass(frozen=True)
class Errors:
    """Errors ``PLR - distance`` over points that both answer; plain numbers, fit for JSON.

    Attributes:
        num_points: Number of points.
        num_unanswered: Points whose distance is finite and the PLR's answer is not; they count nowhere else.
        loss: Mean of the loss that was refined against, without weights and penalties.
        mean: Mean absolute error.
        rms: Root of the mean squared error.
        max: Largest absolute error.
        max_over: Largest over-estimate; 0 if there is none.
        over: Share of points that are over-estimated.
        eikonal_rms: Root of the mean of ``(|slope| - 1)**2`` over the points, with the leaf's (mean) slope.
    """

    num_points: int
    num_unanswered: int
    loss: float
    mean: float
    rms: float
    max: float
    max_over: float
    over: float
    eikonal_rms: float


@dataclass(frozen=True)
class Stage:
    """A PLR on the way: as given, after cell-by-cell least squares, or refined.

    Attributes:
        num_bytes: Size of its file.
        training: Errors over the points that it was fitted to.
        held_out: Errors over the points that were set aside for this; None if none were.
        jump_rms: Root of the mean squared jump over the points of free faces; None without any.
    """

    num_bytes: int
    training: Errors
    held_out: Errors | None
    jump_rms: float | None


@dataclass(frozen=True)
class Refinement:
    """What :func:`refine` did. ``print`` shows it as a table.

    Its columns are the size of the file; of the errors the mean loss, the mean and the largest; the share of points
    that are over-estimated; and the root mean squares of ``|slope| - 1`` and of the jumps. No point is weighted.

    Attributes:
        given: The PLR that was given.
        least_squares: The same partition with each cell's own (weighted) least-squares plane.
        refined: The PLR that was returned.
        num_unreachable: Points left out because their distance is infinite.
        num_kept: Reachable leaves with too few points of their own.
        num_steps: Steps that were taken; fewer than asked for if interrupted.
        objective: Mean loss plus penalties, before the first step (of cell-by-cell least squares) and at the best.
        shift: What was added to every value at the end, so that the asked share of points is over-estimated; 0
            for a loss that asks for none.
    """

    given: Stage
    least_squares: Stage
    refined: Stage
    num_unreachable: int
    num_kept: int
    num_steps: int
    objective: tuple[float, float]
    shift: float

    def __str__(self) -> str:
        lines = [f"{'':16}{'bytes':>7}{'loss':>11}{'mean':>11}{'max':>11}{'over':>8}{'|slope|-1':>11}{'jumps':>11}"]
        for name in ("given", "least_squares", "refined"):
            stage: Stage = getattr(self, name)
            errors = stage.held_out or stage.training
            jump = "-" if stage.jump_rms is None else f"{stage.jump_rms:.3g}"
            lines.append(
                f"{name.replace('_', ' '):16}{stage.num_bytes:>7}{errors.loss:>11.3g}{errors.mean:>11.3g}"
                f"{errors.max:>11.3g}{errors.over:>8.2%}{errors.eikonal_rms:>11.3g}{jump:>11}"
            )
        what = "held-out" if self.refined.held_out else "training"
        return "\n".join(lines) + f"\nerrors over {what} points, after {self.num_steps} steps"


def measure_errors(plr: PLR, x: Points, distance: Distances, loss: Loss) -> Errors:
    """Errors of a PLR's answers at points of finite distance."""
    answer = np.asarray(plr(x), np.float64)
    answered = np.isfinite(answer)
    error = (answer - distance)[answered]
    slope = plr.slope[leaf_of(plr, x)]
    residual = np.linalg.norm(slope[answered], axis=1) - 1
    if len(error) == 0:
        raise ValueError("No error is defined: the PLR answers none of the points whose distance is finite.")
    return Errors(
        num_points=len(error),
        num_unanswered=int(np.count_nonzero(~answered)),
        loss=float(np.mean(np.asarray(loss(jnp.asarray(error)), np.float64))),
        mean=float(np.abs(error).mean()),
        rms=_rms(error),
        max=float(np.abs(error).max()),
        max_over=float(error.max(initial=0.0)),
        over=float(np.mean(error > 0)),
        eikonal_rms=_rms(residual),
    )


def measure_jumps(plr: PLR, faces: Faces | None) -> float | None:
    """Root mean square of a PLR's jumps; None where there are no points."""
    return _rms(faces.jumps(plr)) if faces else None


def _rms(values: Float[np.ndarray, "n"]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


_CALIBRATION = 0.2  # share of the training points with which the height is set, where a loss asks for a share


class RefinementInterrupted(UserWarning):
    """Ctrl-C ended a refinement early; what it returns is the best found so far."""


def refine(
    plr: PLR,
    x: ArrayLike,
    distance: ArrayLike,
    *,
    loss: Loss = squared,
    weight: ArrayLike | None = None,
    penalties: Sequence[Penalty] = (),
    faces: Faces | None = None,
    max_bytes: int | None = None,
    num_steps: int = 400,
    held_out: int | float = 0.2,
    seed: int = 0,
) -> tuple[PLR, Refinement]:
    """Move the functions of all leaves of a PLR at once, so that a loss over many points becomes small.

    It is for what :func:`construct` does not do: another loss, penalties, other distances, or points that lie where
    accuracy matters. To the same distances, by squares, leaves are fitted already, and mostly from more points.

    The partition stays, and so does the precision of the numbers stored: a query costs the same, and the file is of
    about the same size (a few bytes more or less, where differences need more or fewer bits). Leaves that were
    unreachable stay so. A leaf with fewer than four points a parameter (a plane has ``dim + 1``; where leaves share
    parameters, what a leaf has on average counts, rounded up) is not fitted to them: a plane stays as it was, but for
    rounding, and a leaf that shares parameters moves along with its neighbors, though it holds on to its function.

    With a loss that asks for a share of over-estimates (:func:`quantile`), another fifth of the training points is
    kept apart. At the end, after rounding to what the file holds, one number is added to all values, so that at most
    the asked share of those points is over-estimated. A new point drawn like ``x`` is then over-estimated with a
    probability of at most that share, and of less by at most one part in their number: over the whole domain, on
    average over such draws of points, up to rounding to 32-bit floats. Nothing is promised for a part of the domain
    alone, nor about the largest over-estimate.

    Args:
        plr: The PLR to start from, of any leaf model. Its functions matter only where a leaf has too few points.
        x: Points inside the domain, ``(n, dim)``; many more than leaves. Where they are dense, accuracy matters.
        distance: Distance to the goal at each, ``(n,)``. Points of infinite (or masked) distance are left out.
        loss: Loss of the errors ``plr(x) - distance``: ``squared``, ``quantile(share)``, or your own function in
            JAX. One that is made anew for each call is compiled anew for each call.
        weight: Weight of each point in the mean loss, ``(n,)``, finite and >= 0; None: all 1. Points of weight 0
            still count in the report, and where the share of over-estimates is set.
        penalties: What is added to the mean loss: ``eikonal(weight)``, ``jumps(faces, weight)``, or your own
            functions of :class:`Planes`. They move a leaf by at most some sixty times its least-squares error
            (or a hundredth of how much it varies in its leaf) in 400 steps.
        faces: Points of free faces at which the report measures jumps; None: it has no jumps.
        max_bytes: Largest size of the file; None: no limit. Where it is exceeded, by however little, all numbers of
            a kind lose a bit or more, and accuracy with it: leave room for a few bytes more than the PLR has.
        num_steps: Steps of the optimizer, in each of which all points take part; at least 1, rounded up to a
            multiple of 50. Strong penalties need more of them.
        held_out: Share of the points, from 0 to below 1, that are not fitted to but measured in the report.
        seed: Seed of which points are set aside. The same seed gives the same PLR (on a CPU).

    Returns:
        The refined PLR, and what was gained over the given one and over cell-by-cell least squares. If interrupted
        (Ctrl-C), the best found so far, with a ``RefinementInterrupted`` warning.

    Raises:
        ValueError: If an argument has another shape or is out of its range, a point lies outside the domain, a
            distance is NaN or ``-inf``, no leaf has enough points, the points kept apart are fewer than one over the
            share of over-estimates, the loss gives another shape or no finite number, ``faces`` are those of another
            partition, or not even the coarsest numbers fit into ``max_bytes``.

    References:
        Romano, Patterson and Candès, "Conformalized quantile regression", NeurIPS 2019, of which the added number is
        the simplest case. Kingma and Ba, "Adam", ICLR 2015.
    """
    _check_functions(plr, loss, penalties)
    _check_numbers(num_steps, held_out, max_bytes, seed)
    samples, num_unreachable = _check_points(plr, x, distance, weight)
    share = getattr(loss, "share", None)
    training, measured, calibration = _set_aside(
        samples, float(held_out), 0.0 if share is None else _CALIBRATION, seed
    )
    if share is not None:
        _check_share(share, len(calibration.x))
    refinable = pose(plr, training)
    least_squares = _restored(plr, refinable.values, max_bytes)

    with jax.numpy_dtype_promotion("standard"):  # Optax counts its steps in integers
        z, objective, steps_taken = minimize(refinable.objective, loss, tuple(penalties), num_steps)
    if steps_taken < num_steps:
        message = f"Interrupted after {steps_taken} of {num_steps} steps: the PLR is the best found so far."
        warnings.warn(message, RefinementInterrupted, stacklevel=2)
    refined, shift = _restored(plr, refinable.at(z), max_bytes), 0.0
    if share is not None:
        shift = _conformal_shift(refined, calibration, share)
        refined = with_stored(plr, as_linear(plr.leaf).raised(refined.stored, shift))

    def stage(plr: PLR) -> Stage:
        errors = [measure_errors(plr, s.x, s.distance, loss) if len(s.x) else None for s in (training, measured)]
        return Stage(plr.num_bytes, errors[0], errors[1], measure_jumps(plr, faces))  # type: ignore[arg-type]

    return refined, Refinement(
        given=stage(plr),
        least_squares=stage(least_squares),
        refined=stage(refined),
        num_unreachable=num_unreachable,
        num_kept=int(np.count_nonzero(~refinable.has_enough & ~plr.unreachable)),
        num_steps=steps_taken,
        objective=objective,
        shift=shift,
    )


def _check_functions(plr: PLR, loss: Loss, penalties: Sequence[Penalty]) -> None:
    if not isinstance(plr, PLR):
        raise ValueError(f"Only a PLR, as construct builds, can be refined, got {shortened(plr)}.")
    if not callable(loss):
        raise ValueError(f"loss must be a function, such as squared or quantile(0.05), got {shortened(loss)}.")
    if not (isinstance(penalties, Sequence) and all(map(callable, penalties))):
        raise ValueError(f"penalties must be a list of functions, such as [eikonal()], got {shortened(penalties)}.")


def _check_numbers(num_steps: int, held_out: int | float, max_bytes: int | None, seed: int) -> None:
    for name, value, least in (("num_steps", num_steps, 1), ("seed", seed, 0), ("max_bytes", max_bytes, 1)):
        if name != "max_bytes" or value is not None:
            require_integer(name, value, least)
    as_number("held_out", held_out, "a share of the points, from 0 to below 1", lambda share: 0 <= share < 1)


def _check_share(share: int | float, num_points: int) -> None:
    """Whether so many points can set the height: even the largest of their errors is exceeded now and then."""
    as_number("A loss's share of over-estimates", share, "between 0 and 1", lambda share: 0 < share < 1)
    if np.ceil((num_points + 1) * (1 - share)) > num_points:
        raise ValueError(
            f"To over-estimate a share of {share:g} at most takes {np.ceil(1 / share) - 1:g} points to set the "
            f"height by, here there are {num_points} (see refine): give more points, or ask for a larger share."
        )


def _check_points(
    plr: PLR, x: ArrayLike, distance: ArrayLike, weight: ArrayLike | None
) -> tuple[WeightedPoints, int]:
    """The points of finite distance, and how many others there are."""
    x = as_points("x", x, plr.dim)
    distance = _column("distance", with_inf_for_masked(distance), len(x))
    weight = np.ones(len(x)) if weight is None else _column("weight", weight, len(x))
    outside = ~plr.domain.contains(x)
    if outside.any():
        raise ValueError(f"All points must lie in {plr.domain}, got {x[outside][0].tolist()}; leave such points out.")
    bad = np.isnan(distance) | (distance == -np.inf)
    if bad.any():
        raise ValueError(
            f"A distance must be a number, or inf where the goal cannot be reached, got {distance[bad][0]} at "
            f"{x[bad][0].tolist()}."
        )
    bad = ~(np.isfinite(weight) & (weight >= 0))
    if bad.any():
        raise ValueError(f"A weight must be finite and >= 0, got {weight[bad][0]}.")
    finite = np.flatnonzero(distance < np.inf)
    return WeightedPoints(x, distance, weight).take(finite), len(x) - len(finite)


def _column(name: str, value: ArrayLike, num_points: int) -> Float[np.ndarray, "n"]:
    column = as_numbers(name, value, f"numbers of shape ({num_points},)")
    if column.shape != (num_points,):
        raise ValueError(f"{name} must have one number a point, shape ({num_points},), got {column.shape}.")
    return column


def _set_aside(
    samples: WeightedPoints, held_out: float, calibration: float, seed: int
) -> tuple[WeightedPoints, WeightedPoints, WeightedPoints]:
    """Points to fit to, points to measure at, and points to set the height by, at random."""
    order = np.random.default_rng(seed).permutation(len(samples.x))
    num_held_out = int(held_out * len(order))
    num_calibration = int(calibration * (len(order) - num_held_out))
    measured, calibrating, training = np.split(order, [num_held_out, num_held_out + num_calibration])
    return samples.take(training), samples.take(measured), samples.take(calibrating)


def _restored(plr: PLR, values: Float[np.ndarray, "parameters"], max_bytes: int | None) -> PLR:
    """The PLR with other parameters, stored with as many bits as before, or as many as fit."""
    for stored in as_linear(plr.leaf).restored(plr.stored, values):
        restored = with_stored(plr, stored)
        if max_bytes is None or restored.num_bytes <= max_bytes:
            return restored
    raise ValueError(
        f"max_bytes={max_bytes} is too small for {plr.num_leaves} leaves: they need {restored.num_bytes}."
    )


def _conformal_shift(plr: PLR, samples: WeightedPoints, share: float) -> float:
    """What must be added to all values so that no more than a share of points like these is over-estimated.

    Of ``n`` errors and a new one, each is equally likely to be the ``k``-th smallest of ``n + 1``.
    """
    error = np.asarray(plr(samples.x), np.float64) - samples.distance
    error = np.sort(error[np.isfinite(error)])
    rank = min(int(np.ceil((len(error) + 1) * (1 - share))), len(error))
    return -float(error[rank - 1]) if rank else 0.0
