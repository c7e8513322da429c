"""What a refinement gained: errors of a PLR over points, before and after."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from plr_jax._types import Distances, Points
from plr_jax.plr._location import leaf_of
from plr_jax.plr._plr import PLR
from plr_jax.plr.refinement.face_samples import Faces
from plr_jax.plr.refinement.losses import Loss


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
