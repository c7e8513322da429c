"""Points on the faces between leaves that one can step across: where a PLR may jump and the distance does not."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from plr_jax._arrays import require_integer
from plr_jax._types import DistanceFn
from plr_jax.plr._location import local_coordinates, unfolded_points
from plr_jax.plr._plr import PLR
from plr_jax.plr.leaves.base import as_linear
from plr_jax.plr.partition.faces import face_points, shared_faces
from plr_jax.plr.partition.tree import tree_of
from plr_jax.plr.sampling.cell_fit import call_oracle

_SAME = 1e-6  # of a leaf's width


@dataclass(frozen=True, eq=False)
class Faces:
    """Points on faces between two reachable leaves, all of them reachable themselves.

    Attributes:
        x: The points.
        leaves: The two leaves that meet at each point, the one below the face first.
        u: The point in the local coordinates of each of the two; ``[-1, 1]`` spans a leaf.
        basis: What the coefficients of each of the two multiply there.
    """

    x: Float[np.ndarray, "m dim"]
    leaves: Int[np.ndarray, "m 2"]
    u: Float[np.ndarray, "m 2 dim"]
    basis: Float[np.ndarray, "m 2 terms"]

    def __len__(self) -> int:
        return len(self.x)

    def jumps(self, plr: PLR) -> Float[np.ndarray, "m"]:
        """Value above the face minus value below it, for any PLR of the partition that was sampled.

        Raises:
            ValueError: If the PLR has another partition, or leaves of another kind.
        """
        is_here = self.leaves.max(initial=0) < plr.num_leaves and self.x.shape[1] == plr.dim
        is_here = is_here and as_linear(plr.leaf).basis(np.zeros((1, plr.dim))).shape[1] == self.basis.shape[2]
        if not (is_here and (np.abs(local_coordinates(plr, self.leaves, self.x[:, None]) - self.u) < _SAME).all()):
            raise ValueError(f"These faces are not those of {plr}; sample_faces gives its own.")
        below, above = (plr.values_in_leaves(leaf, self.x) for leaf in self.leaves.T)
        return above - below


def sample_faces(plr: PLR, distance_fn: DistanceFn, *, num_samples: int = 8, seed: int = 0) -> Faces:
    """Sample the free faces of a PLR's partition.

    Each piece of a face that two leaves share is sampled alike, so where small leaves meet a large one each has its
    points. A face is free where the goal can be reached from it: inside a wall it has no points. The side of a wall
    is free, so a face along it has points, although nobody can step across. What a leaf around a whole periodic axis
    shares with itself is left out.

    Args:
        plr: The PLR whose partition is meant.
        distance_fn: Distance to the goal for a batch of points ``(n, dim)``; ``inf`` where it cannot be reached.
        num_samples: Points on each such piece, before those are left out that are not free; at least 1.
        seed: Seed of the points. The same seed gives the same points.

    Returns:
        The points and the two leaves that meet in each.

    Raises:
        ValueError: If ``num_samples`` is not positive, ``seed`` is negative, or ``distance_fn`` returns a wrong
            shape or NaN.
    """
    require_integer("num_samples", num_samples, 1)
    require_integer("seed", seed, 0)
    tree = tree_of(plr.cells)
    faces = shared_faces(tree, plr.folded_domain.periodic)
    pairs = tree.order[np.stack([faces.lower, faces.upper], axis=1)]
    kept = ~plr.unreachable[pairs].any(axis=1) & (faces.lower != faces.upper)
    w = np.random.default_rng(seed).uniform(size=(int(num_samples), plr.dim))
    points = plr.folded_domain.lo + plr.folded_domain.width * face_points(tree.leaves, faces[kept], w)
    x, leaves = unfolded_points(plr, points.reshape(-1, plr.dim)), np.repeat(pairs[kept], len(w), axis=0)
    free = np.isfinite(call_oracle(distance_fn, x)) if len(x) else np.zeros(0, bool)
    x, leaves = x[free], leaves[free]
    u = local_coordinates(plr, leaves, x[:, None])
    basis = as_linear(plr.leaf).basis(u.reshape(-1, plr.dim))
    return Faces(x, leaves, u, basis.reshape(len(x), 2, basis.shape[1]))
