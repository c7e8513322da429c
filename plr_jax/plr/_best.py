"""``leaf="best"``: leaves of the models that may serve a distance function best, of which those that err least."""

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from tqdm import tqdm

from plr_jax._arrays import as_distances
from plr_jax._types import ArrayLike, CellSources, CellwiseFn, DistanceFn, Distances, Sources
from plr_jax.geometry.box import Box
from plr_jax.plr._file import Contents, encode
from plr_jax.plr.growth.limits import ConstructionInterrupted
from plr_jax.plr.leaves import leaf_model, leaf_names
from plr_jax.plr.leaves.base import SourcedLeafModel
from plr_jax.plr.partition.cells import grown_domain
from plr_jax.plr.portable.numpy import NumpyPLR

BEST = "best"
_MOST_TIED_AXES = 6
_CROWDED, _BYTES_A_SOURCE = 4, 7
"""Times the budget that all corners may take where leaves that name them are tried, and bytes of one."""
_ERROR_POINTS = 4096

_Built = TypeVar("_Built")


@dataclass(frozen=True, eq=False)
class Best:
    """The leaves that err least, the error of each model that was built, and whether that was interrupted.

    Errors are the largest, as proven; where nothing is, the mean at points of the domain, NaN of a single model.
    """

    contents: Contents
    errors: dict[str, float]
    is_interrupted: bool


@dataclass(frozen=True, eq=False)
class _OracleOfBox:
    """An oracle that finds once what it says of a box as one cell, for all leaf models that are tried."""

    oracle: CellwiseFn
    box: Box

    @cached_property
    def cell(self) -> CellSources:
        return self.oracle.cell_sources(self.box)

    @property
    def sources(self) -> Sources:
        return self.cell.sources

    def cell_sources(self, domain: Box) -> CellSources:
        return self.cell if domain == self.box else self.oracle.cell_sources(domain)

    def __call__(self, x: ArrayLike) -> Distances:
        return np.ma.filled(self.oracle(x), np.inf)


def best_leaves(
    construct: Callable[..., Contents],
    distance_fn: DistanceFn,
    domain: Box,
    *,
    leaf: str = BEST,
    what: str = "construct",
    **options: Any,
) -> Best:
    """Leaves of one model, or those that err least of all that may serve.

    Those that cannot be built are left out; ``ValueError`` if none can be built. An interrupt (Ctrl-C) ends what is
    being built and leaves the rest untried. A terminal shows how many models of ``what`` are done, and which is being
    built.
    """
    if isinstance(distance_fn, CellwiseFn) and domain.dim == 2 and not domain.is_periodic:
        distance_fn = _OracleOfBox(distance_fn, grown_domain(domain))
    is_certified = bool(options.get("certified"))
    names = _tried(distance_fn, domain, is_certified, options) if leaf == BEST else [leaf]
    best, least, errors, refused, is_interrupted = None, math.inf, {}, [], False
    with tqdm(names, what, unit=" models", leave=False, disable=None) as progress:
        for name in progress:
            progress.set_description(f"{what}: leaves of kind {name!r}")
            try:
                contents, is_interrupted = constructed(construct, distance_fn, domain, leaf=name, **options)
            except ValueError as error:  # as of a budget that is too small for one leaf of this model
                refused.append(error)
                continue
            except KeyboardInterrupt:
                if best is None:
                    raise
                is_interrupted = True
                break
            errors[name] = math.nan
            if is_certified:
                proof = contents.certificate
                errors[name] = math.inf if proof is None else proof.max_error  # there is none of what was interrupted
            elif len(names) > 1:
                try:
                    errors[name] = _mean_error(contents, distance_fn, options["seed"])
                except KeyboardInterrupt:
                    is_interrupted = True
            if best is None or errors[name] < least:
                best, least = contents, errors[name]
            if is_interrupted:
                break
    if best is None:
        raise min(refused, key=lambda error: getattr(error, "num_bytes", math.inf))
    return Best(best, errors, is_interrupted)


def _tried(distance_fn: DistanceFn, domain: Box, is_certified: bool, options: dict[str, Any]) -> list[str]:
    """The leaf models to choose from: cones alone where all corners have room, all but these where few have.

    On all maps of the experiments cones with that room err ten to a thousand times less on average than the others.
    Of the others all are tried for the least proven error, of which no rule is known. On average continuous ones err
    less than planes, and about as much as smooth ones, which take longer to build and to query.
    """
    sourced = [name for name in leaf_names() if isinstance(leaf_model(name), SourcedLeafModel)]
    others = [name for name in leaf_names() if name not in sourced]
    if not is_certified:
        others = ["continuous" if domain.dim <= _MOST_TIED_AXES else "plane"]
    if not isinstance(distance_fn, _OracleOfBox):
        return others
    of_corners = _BYTES_A_SOURCE * np.count_nonzero(np.isfinite(distance_fn.sources.distances))
    max_bytes = options.get("max_bytes")
    share = of_corners / max_bytes if isinstance(max_bytes, int | float) and max_bytes > 0 else 0.0
    if share <= 1 and options.get("max_leaves") is options.get("max_depth") is None:
        return sourced
    return [name for name in leaf_names() if name in others or (name in sourced and share <= _CROWDED)]


def constructed(construct: Callable[..., _Built], *args: Any, **options: Any) -> tuple[_Built, bool]:
    """What a function builds, and whether that was interrupted, of which there is no other warning."""
    is_interrupted = False
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ConstructionInterrupted)
        built = construct(*args, **options)
    for warning in caught:
        if issubclass(warning.category, ConstructionInterrupted):
            is_interrupted = True
        else:
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
    return built, is_interrupted


def _mean_error(contents: Contents, distance_fn: DistanceFn, seed: int) -> float:
    domain = contents.domain
    x = domain.lo + domain.width * np.random.default_rng(seed).random((_ERROR_POINTS, domain.dim))
    distance = as_distances("The distance function", distance_fn(x), x)
    reached = np.isfinite(distance)
    return float(np.abs(NumpyPLR(encode(contents))(x[reached]) - distance[reached]).sum() / max(1, reached.sum()))
