"""Where a cell is sampled, the same in every cell, and what of a fit depends on that alone."""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import product

import numpy as np
from jaxtyping import Float

_RANK_TOLERANCE = 1e-9
_FACE_WEIGHT = 0.01


@dataclass(frozen=True, eq=False)
class Pattern:
    """Where a cell is sampled, the same in every cell.

    Attributes:
        u: Local coordinates of the samples; ``[-1, 1]`` spans the cell.
        weight: Weight of each sample in the fit.
    """

    u: Float[np.ndarray, "k dim"]
    weight: Float[np.ndarray, "k"]

    def __len__(self) -> int:
        return len(self.u)

    @cached_property
    def reaches_beyond(self) -> bool:
        """Whether some samples are outside their cell."""
        return bool((np.abs(self.u) > 1).any())

    @cached_property
    def design(self) -> Float[np.ndarray, "k terms"]:
        """Rows ``[1 u]``: a plane's values at the samples are ``design @ [center half]``."""
        return np.concatenate([np.ones((len(self), 1)), self.u], axis=1)

    @cached_property
    def pseudo_inverse(self) -> Float[np.ndarray, "terms k"]:
        """Maps the values at all samples to the least-squares plane."""
        root = np.sqrt(self.weight)
        return np.linalg.pinv(self.design * root[:, None]) * root

    @cached_property
    def halves(self) -> list[Float[np.ndarray, "k terms_of_both"]]:
        """For each axis the designs of a plane in the lower and one in the upper half, side by side; 0 elsewhere."""
        uppers = [self.u[:, axis, None] > 0 for axis in range(self.u.shape[1])]
        return [np.concatenate([self.design * ~upper, self.design * upper], axis=1) for upper in uppers]

    @cached_property
    def halves_bases(self) -> list[Float[np.ndarray, "k terms_of_both"]]:
        """For each axis what maps the values at all samples to coordinates of the best fit by two planes.

        The coordinates belong to orthonormal functions, so the sum of their squares is the part of the values' sum
        of (weighted) squares that the planes explain.
        """
        root = np.sqrt(self.weight)[:, None]
        bases = []
        for design in self.halves:
            functions, size, _ = np.linalg.svd(design * root, full_matrices=False)
            bases.append(root * functions * (size > _RANK_TOLERANCE * size[0]))
        return bases


@lru_cache(maxsize=8)
def sample_pattern(dim: int, num_samples: int, margin: int | float, seed: int) -> Pattern:
    """The center, a scrambled Sobol sequence inside the cell, its corners if they are few, and its faces.

    A third of the samples lie on the faces. They find the free slivers behind a wall and the corners at which a
    distance bends most against its plane; they check the fit more than they shape it, so their weight is small.
    There must be ``dim + 1`` or more; their coordinates are in ``[-1 - 2 margin, 1 + 2 margin]``.
    """
    rng = np.random.default_rng(seed)
    center = np.zeros((1, dim))
    corners = np.array(list(product((-1.0, 1.0), repeat=dim)) if 4 * 2**dim <= num_samples else []).reshape(-1, dim)
    faces = _sobol(dim, num_samples // 3, rng)
    face = np.arange(len(faces)) % (2 * dim)
    faces[np.arange(len(faces)), face // 2] = 2.0 * (face % 2) - 1
    inside = _sobol(dim, num_samples - 1 - len(corners) - len(faces), rng)
    u = np.concatenate([center, inside, corners, faces]) * (1 + 2 * margin)
    weight = np.repeat([1.0, _FACE_WEIGHT], [1 + len(inside), len(corners) + len(faces)])
    return Pattern(u, weight)


def _sobol(dim: int, num_points: int, rng: np.random.Generator) -> Float[np.ndarray, "n dim"]:
    from scipy.stats import qmc  # half a second of import that a query does not need

    exponent = max(num_points - 1, 0).bit_length()
    return 2 * qmc.Sobol(dim, rng=rng).random_base2(exponent)[:num_points] - 1
