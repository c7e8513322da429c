"""Which cells are of one and the same source, and where it is, from cones fitted to the samples of each.

The most certain cone claims all cells whose samples it meets, to within the noise and its own uncertainty there; it
is fitted again to all their samples, claims anew, and so on. So noise averages out over all that a source explains.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from plr_jax.plr.leaves.cone.fit import Cones, Samples, fit_cones, normal_equations, refine_cones, slopes

BEYOND_NOISE = 6.0  # times its root mean square no sample errs
_MOST_UNCERTAIN = 10.0  # times the noise is what a claim may be
_UNLIKELY = 5.0  # standard deviations of a mean square
_CLAIMS = 10


@dataclass(frozen=True, eq=False)
class Patches:
    """Cells and the cones that fit them.

    Attributes:
        samples: Their samples.
        cones: Their cones.
        error: Root mean square error of each, per degree of freedom.
        spread: By how much each source and offset is uncertain, times the noise.
    """

    samples: Samples
    cones: Cones
    error: Float[np.ndarray, "cells"]
    spread: Float[np.ndarray, "cells"]

    @staticmethod
    def fitted(samples: Samples, farthest: float) -> "Patches":
        """A cone for each cell, its source at most so far away."""
        cones = fit_cones(samples, farthest)
        count, terms = (samples.weight > 0).sum(axis=1), samples.x.shape[2] + 1
        error = np.sqrt(cones.mean_square(samples) * count / (count - terms))
        covariance = np.linalg.inv(normal_equations(samples, cones)[0])
        return Patches(samples, cones, error, np.sqrt(np.trace(covariance, axis1=1, axis2=2)))

    def __len__(self) -> int:
        return len(self.error)

    def are_of_noise(self, noise: float) -> Bool[np.ndarray, "cells"]:
        """Which err as noise makes them: where two sources that differ by little meet, cones err by more."""
        freedom = (self.samples.weight > 0).sum(axis=1) - self.samples.x.shape[2] - 1
        return self.error <= noise * (1 + _UNLIKELY / np.sqrt(2 * freedom))

    def __getitem__(self, index) -> "Patches":
        return Patches(self.samples[index], self.cones[index], self.error[index], self.spread[index])

    def append(self, other: "Patches") -> "Patches":
        """These, followed by others."""
        error, spread = np.append(self.error, other.error), np.append(self.spread, other.spread)
        return Patches(self.samples.append(other.samples), self.cones.append(other.cones), error, spread)


@dataclass(frozen=True, eq=False)
class Clusters:
    """Sources, each with all samples that are of it."""

    cones: Cones
    samples: Sequence[Samples]

    def explain(self, samples: Samples, noise: float) -> Bool[np.ndarray, "cells"]:
        """Which cells have no samples but such as lie on some cone."""
        closest = np.full(samples.distance.shape, np.inf)
        for index in range(len(self.cones)):
            closest = np.minimum(closest, np.abs(self.cones[[index]].errors(samples)))
        return closest.max(axis=1) <= BEYOND_NOISE * noise


def cluster_patches(patches: Patches, noise: float, farthest: float) -> Clusters:
    """All sources of patches, each once, the most certain first."""
    rest = patches[np.argsort(patches.spread, kind="stable")]
    cones, samples = patches.cones[:0], []
    while len(rest):
        claimed = np.arange(len(rest)) == 0
        cone, own = rest.cones[:1], rest.samples[:1]
        for _ in range(_CLAIMS):
            claims = _meets(cone, own, rest.samples, noise)
            claims[0] = True
            if np.array_equal(claims, claimed):
                break
            claimed, own = claims, rest.samples[claims].as_one()
            cone = refine_cones(own, cone, farthest)
        cones, rest = cones.append(cone), rest[~claimed]
        samples.append(own.as_one())
    return Clusters(cones, samples)


def _meets(cone: Cones, own: Samples, samples: Samples, noise: float) -> Bool[np.ndarray, "cells"]:
    """Which cells' samples all lie on a cone, as far as it is certain from its own samples."""
    covariance = np.linalg.inv(normal_equations(own, cone)[0][0])
    slope = slopes(samples, cone)
    variance = np.einsum("cki,ij,ckj->ck", slope, covariance, slope)
    error = np.abs(cone.errors(samples))
    return (error <= BEYOND_NOISE * noise * np.sqrt(1 + np.clip(variance, 0, _MOST_UNCERTAIN**2))).all(axis=1)
