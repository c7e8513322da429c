"""Points on the faces between leaves that one can step across: where a PLR may jump and the distance does not."""

from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Float, Int

from plr_jax._types import DistanceFn
from plr_jax.plr._fit import call_oracle
from plr_jax.plr._plr import PLR
from plr_jax.plr._tables import lookup

_SAME = 1e-6  # of a leaf's width


@dataclass(frozen=True, eq=False)
class Faces:
    """Points on faces between two reachable leaves, all of them reachable themselves.

    Attributes:
        x: The points.
        leaves: The two leaves that meet at each point, the one below the face first.
        u: The point in the local coordinates of each of the two; ``[-1, 1]`` spans a leaf.
    """

    x: Float[np.ndarray, "m dim"]
    leaves: Int[np.ndarray, "m 2"]
    u: Float[np.ndarray, "m 2 dim"]

    def __len__(self) -> int:
        return len(self.x)

    def jumps(self, plr: PLR) -> Float[np.ndarray, "m"]:
        """Value above the face minus value below it, for any PLR of the partition that was sampled.

        Raises:
            ValueError: If the PLR has another partition.
        """
        if not self._fit(plr):
            raise ValueError(f"These faces are not those of {plr}; sample_faces gives its own.")
        center, half = plr.planes.decode()
        value = center[self.leaves] + np.sum(half[self.leaves] * self.u, axis=2)
        return value[:, 1] - value[:, 0]

    def _fit(self, plr: PLR) -> bool:
        """Whether the points are where the PLR's leaves say that they are."""
        if self.leaves.max(initial=0) >= plr.num_leaves or self.x.shape[1] != plr.dim:
            return False
        return bool((np.abs(_local(plr, self.x, self.leaves) - self.u) < _SAME).all())


def sample_faces(plr: PLR, distance_fn: DistanceFn, *, num_samples: int = 8, seed: int = 0) -> Faces:
    """Sample the free faces of a PLR's partition.

    Every face of every leaf is sampled alike, so where small leaves meet a large one each has its points. A face
    is free where the goal can be reached from it: a wall through it, or along it, has no points.

    Args:
        plr: The PLR whose partition is meant.
        distance_fn: Distance to the goal for a batch of points ``(n, dim)``; ``inf`` where it cannot be reached.
        num_samples: Points on each face of a leaf, before those are left out that are not free; at least 1.
        seed: Seed of the points. The same seed gives the same points.

    Returns:
        The points and the two leaves that meet in each.

    Raises:
        ValueError: If ``num_samples`` is not positive, ``seed`` is negative, or ``distance_fn`` returns a wrong
            shape or NaN.
    """
    if not isinstance(num_samples, int | np.integer) or num_samples < 1:
        raise ValueError(f"num_samples must be an integer >= 1, got {num_samples!r}.")
    if not isinstance(seed, int | np.integer) or seed < 0:
        raise ValueError(f"seed must be an integer >= 0, got {seed!r}.")
    x, leaves = _face_points(plr, np.random.default_rng(seed).uniform(size=(int(num_samples), plr.dim)))
    kept = ~plr.planes.unreachable[leaves].any(axis=1)
    x, leaves = x[kept], leaves[kept]
    free = np.isfinite(call_oracle(distance_fn, x)) if len(x) else np.zeros(0, bool)
    x, leaves = x[free], leaves[free]
    return Faces(x, leaves, _local(plr, x, leaves))


def _local(plr: PLR, x: Float[np.ndarray, "m dim"], leaves: Int[np.ndarray, "m 2"]) -> Float[np.ndarray, "m 2 dim"]:
    """Coordinates of each point in both of its leaves."""
    lo, hi = plr.leaf_boxes
    return (2 * x[:, None] - lo[leaves] - hi[leaves]) / (hi - lo)[leaves]


def _face_points(
    plr: PLR, fraction: Float[np.ndarray, "k dim"]
) -> tuple[Float[np.ndarray, "m dim"], Int[np.ndarray, "m 2"]]:
    """Points on all faces of all leaves but those on the domain's boundary, and the leaves below and above.

    The leaf across a face is looked up half a smallest cell beyond it, where no rounding matters.
    """
    (lo, hi), depth = plr.leaf_boxes, plr.cells.depth.max(axis=0)
    inside = lo[:, None] + fraction * (hi - lo)[:, None]
    own = np.broadcast_to(np.arange(len(lo))[:, None], inside.shape[:2])
    points, pairs = [], []
    for axis in range(plr.dim):
        step = 0.5 * np.ldexp(plr.domain.width[axis], -int(depth[axis]))
        for side, edge, end in ((-1, lo, plr.domain.lo), (1, hi, plr.domain.hi)):
            inner = edge[:, axis] != end[axis]
            x, leaf = inside[inner].copy(), own[inner]
            x[:, :, axis] = edge[inner, axis, None]
            beyond = x.copy()
            beyond[:, :, axis] += side * step
            across = leaf_of(plr, beyond)
            points.append(x.reshape(-1, plr.dim))
            pairs.append(np.stack([leaf, across][::side], axis=2).reshape(-1, 2))
    return np.concatenate(points), np.concatenate(pairs)


def leaf_of(plr: PLR, x: Float[np.ndarray, "*batch dim"]) -> Int[np.ndarray, "*batch"]:
    """Index of the leaf that answers for each point."""
    return np.asarray(_lookup(plr.tables, x)).astype(np.int64)


_lookup = jax.jit(lookup)
