"""Build PLRs with :func:`construct` (Algorithm 1 of the paper), and prove error bounds with :func:`certify`."""

import math
import warnings
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from plr_jax._arrays import as_bool, as_distances, as_number, require_function, require_integer, shortened
from plr_jax._progress import Progress
from plr_jax._types import ArrayLike, CellSources, DistanceFn, NearestFn, Reach
from plr_jax.geometry.box import Box
from plr_jax.plr import sampling
from plr_jax.plr._file import DecodedFile, certificates_of, cut_off_leaves, encode, filled_coefficients
from plr_jax.plr.certificate import Proof
from plr_jax.plr.container import frame_size
from plr_jax.plr.folding import folding_of
from plr_jax.plr.frame import table_corners
from plr_jax.plr.growth import ConstructionInterrupted, ShouldSplitRule, SplitRule, best_axis, largest_error
from plr_jax.plr.leaves import Cone, leaf_model
from plr_jax.plr.leaves.base import GivenLimits, LeafModel, Rules, check_limits
from plr_jax.plr.portable.numpy import NumpyPLR
from plr_jax.plr.sampling import NEEDED, FitRule, Sampler, WeightFn, least_squares
from plr_jax.plr.source_cache import SourceCache
from plr_jax.plr.tree import Cells, grown_domain

if TYPE_CHECKING:
    from plr_jax.plr._plr import PLR

# Samples of a cell.
_SAMPLE_FACTORS = 1, 8, 64  # factors of num_samples, tried in turn until enough samples of the domain reach the goal
_DENSE_FACTOR = 8  # a cell in which few samples reach the goal is sampled again with this many times more samples
_MAX_SAMPLES = 2**16
_SPARSE = 1 / 16  # if a smaller share of the domain reaches the goal, cells with few samples are split first
_LEAVES_OF_VOLUMES = 2048  # default limit where rooms must be separated from others in more than two dimensions
_PARTS = 8  # boxes along each axis of a leaf, to measure how much of the leaf is cut off from the goal
# Choice of models for leaf="best". The two ratios were measured on random maps with 10 to 80 blocked cells.
_CROWDED = 4  # cones are tried if all corners take at most this many times the byte budget
_ROOMY = 0.5  # only cones are tried if all corners take at most this share of the byte budget
_BYTES_A_SOURCE = 7  # bytes of a corner in a file if coordinates are on no lattice; else a corner takes at least 3
_ERROR_POINTS = 4096  # random points at which errors of models are compared


@dataclass(frozen=True)
class BuildOptions:
    """Options of :func:`construct` that few users need: rules of Algorithm 1, samples and workers.

    The paper's own configuration is ``BuildOptions(should_split=maximum_depth, split=cyclic_axis)`` with
    ``max_depth=9``, or ``should_split=center_error`` with a tolerance. ``ValueError`` if an option has a wrong type
    or is out of range.

    Args:
        compute_coefficients: Function that fits each cell's plane: ``least_squares`` or your own. For planes only.
        should_split: Function from a ``CellFit`` (the fits of several cells) to a priority for each cell:
            ``largest_error``, ``center_error``, ``maximum_depth`` or your own. The cell of the largest positive
            priority is split next.
        split: Function from a ``CellFit`` to a split axis for each cell: ``best_axis``, ``cyclic_axis`` or your own.
        num_samples: Samples in each cell, at most 65,536. None: 192 for planes, 96 for other leaves. At least ``dim +
            1`` for planes and cones, ``2**dim + 1`` for other leaves; take several times as many.
        margin: Fraction of a cell's width, from 0 to 1, by which samples reach beyond the cell. Use it if distances
            are noisy.
        weight_fn: Function from points ``(n, dim)`` to error weights ``(n,)``, finite and >= 0. None: weight 1.
        executor: ``concurrent.futures.Executor`` that evaluates a slow distance function, 1,024 points at a time; the
            number of workers does not change the PLR. Processes need a picklable function. None: this process.
    """

    compute_coefficients: FitRule = least_squares
    should_split: ShouldSplitRule = largest_error
    split: SplitRule = best_axis
    num_samples: int | None = None
    margin: int | float = 0
    weight_fn: WeightFn | None = None
    executor: Executor | None = None

    def __post_init__(self):
        for name in ("compute_coefficients", "should_split", "split", "weight_fn"):
            if name != "weight_fn" or self.weight_fn is not None:
                require_function(name, getattr(self, name))
        as_number("margin", self.margin, "a fraction from 0 to 1 of a cell's width", lambda value: 0 <= value <= 1)
        if self.num_samples is not None:
            require_integer("num_samples", self.num_samples, 1)
            if self.num_samples > _MAX_SAMPLES:
                raise ValueError(f"num_samples must be at most {_MAX_SAMPLES:,} a cell, got {self.num_samples:,}.")
        if self.executor is not None and not isinstance(self.executor, Executor):
            message = f"executor must be a concurrent.futures.Executor or None, got {shortened(self.executor)}."
            raise ValueError(message)


DEFAULT_OPTIONS = BuildOptions()


def construct(
    distance_fn: DistanceFn,
    domain: Box | tuple[ArrayLike, ArrayLike],
    *,
    leaf: LeafModel | str = "plane",
    max_bytes: int | None = None,
    max_leaves: int | None = None,
    max_depth: int | None = None,
    tolerance: int | float | None = None,
    certified: bool | str = False,
    seed: int = 0,
    options: BuildOptions = DEFAULT_OPTIONS,
) -> "PLR":
    """Build a PLR, a compact approximation of a distance function in a box (Algorithm 1 of the paper).

    The common call names a leaf model and a budget in bytes:

        oracle = plr_jax.VisibilityGraph(workspace, goal)
        plr = plr_jax.construct(oracle, workspace.bounds, leaf="cone", max_bytes=4096, certified=True)
        plr(points)  # distances (n,) of points (n, dim)

    Choose ``"cone"`` for shortest paths among polygons (``VisibilityGraph``), often exact; ``"continuous"`` for other
    distance functions; ``"plane"`` for the paper's leaf and fast queries. Limits may be combined: construction stops
    at the first limit that it reaches. Without limits, it stops at 512 leaves, or at 2,048 leaves if rooms without a
    path to the goal must be separated in more than two dimensions.

    Args:
        distance_fn: Function from points ``(n, dim)`` to distances to the goal ``(n,)``; ``inf`` or a masked entry
            where the goal cannot be reached.
        domain: The box to cover, a ``Box`` or its two corners. Along periodic axes the distance must be periodic.
        leaf: Leaf model: a name from the list below, or an instance such as ``Plane(coefficient_bits=16)``.
        max_bytes: Largest size of the PLR's file, in bytes. Planes then choose the number of bits per coefficient.
        max_leaves: Largest number of leaves.
        max_depth: Largest number of splits between the root and a leaf, at most 60. Lookup tables also limit the
            halvings along each axis: to 14 in the plane, to ``28 // dim`` in ``dim`` > 2 dimensions. In small files,
            leaves other than cones allow fewer halvings, such as 7 for planes in 2 KB.
        tolerance: Error, in units of distance, up to which cells are not split. The error of a cell is its priority
            from ``options.should_split`` or, for cones and certified planes, its proven error.
        certified: True proves ``plr.max_error`` and ``plr.bounds(x)`` for all points that reach the goal.
            ``"leaves"`` stores bounds of every leaf, 2 bytes each. Needs a distance function that *answers for whole
            cells*, as ``VisibilityGraph`` does: see :func:`certify`.
        seed: Seed of the samples. The same seed gives the same PLR.
        options: Rules of fitting and splitting, samples and workers: see :class:`BuildOptions`.

    Leaf models:
        - ``"plane"``: one plane a leaf, fitted best-first. The function may jump between leaves.
        - ``"continuous"``: values at the leaves' corners, shared by neighbors, in up to 6 dimensions. Smaller errors
          per byte than planes, but slower to build and to query.
        - ``"smooth"``: like ``"continuous"``, but with a continuous gradient, in 1 or 2 dimensions; slower.
        - ``"cone"``: an offset plus the distance to a *source*, an obstacle corner or the goal. If the budget has
          room for all corners (a few bytes each), exact except in leaves from which paths go to different corners
          first. Needs a distance function in the plane that answers for whole cells.
        - ``"best"``: builds several models and keeps the one with the smallest error: the largest proven error if
          certified, else the geometric mean of the mean and the largest error at random points. It tries all models
          if certified, else cones, ``"continuous"`` and ``"smooth"``. If the distance function does not answer for
          whole cells, it builds only ``"continuous"``, or ``"plane"`` in more than 6 dimensions. Each
          corner counts as 7 bytes. If all corners take at most half of ``max_bytes``, and neither ``max_leaves``,
          ``max_depth`` nor rules of your own are given, it tries only cones. If all corners take over 4 times
          ``max_bytes``, it tries no cones and, if not certified, no ``"smooth"``.

    A distance function with ``symmetries``, such as ``ReedsShepp``, is *folded*: its PLR stores only
    ``folded_domain`` and mirrors points into it. Cones and certified PLRs are not folded.

    Returns:
        The PLR. After an interrupt (Ctrl-C), the PLR built so far, with a ``ConstructionInterrupted`` warning. Most
        distance functions of this package know where free points cannot reach the goal. There, the PLR answers
        ``inf``, except closer than 1/64 of the domain's width to points that can reach the goal. If the limits are
        too small for this, a warning states an upper estimate of the share of the domain where the PLR wrongly
        answers a finite number. Another warning tells if most of free space cannot reach the goal.

    Raises:
        ValueError: If an argument is out of range, a budget is too small for one leaf, the leaf model or a proof does
            not support this distance function or domain, ``distance_fn`` returns NaN or a wrong shape, or no sample
            reaches the goal.

    References:
        Section III-B of the paper. ``"smooth"``: Bogner, Fox, Schmit 1965. Partition of cones: Donoho, "CART and
        best-ortho-basis: a connection", Annals of Statistics 1997.
    """
    from plr_jax.plr._plr import plr_of_leaves  # imports JAX

    domain = Box.of(domain, "domain, such as workspace.bounds,")
    proof = proof_of(certified)
    require_function("distance_fn", distance_fn)
    if not isinstance(options, BuildOptions):
        raise ValueError(f"options must be BuildOptions(...), got {shortened(options)}.")
    limits = GivenLimits(max_depth, max_leaves, max_bytes, tolerance)
    reach = sampling.reach_of(distance_fn, domain)

    build = partial(_build_leaves, distance_fn, domain, limits, reach, proof, seed, options)
    if leaf == "best":
        has_rules = (options.weight_fn, options.should_split, options.split) != (None, largest_error, best_axis)
        only_bytes = max_leaves is None and max_depth is None and not has_rules
        # Find the sources of the whole domain once, for all models.
        cell_sources = getattr(distance_fn, "cell_sources", None)
        is_plane = domain.dim == 2 and not domain.is_periodic
        root = cell_sources(grown_domain(domain)) if cell_sources and is_plane else None
        names = _models_to_try(root, domain, proof, max_bytes, only_bytes)
        contents = build_best_model(partial(build, root=root), names, partial(_error_of, distance_fn, proof, seed))
    else:
        contents = build(leaf)
    warn_if_cut_off(reach if contents.folding is None else None, contents)
    plr = plr_of_leaves(contents)
    # Files of cones name goals.
    if isinstance(distance_fn, NearestFn) and distance_fn.cell_sources and not isinstance(contents.leaf, Cone):
        return plr.with_nearest_goal(distance_fn.which)
    return plr


def _build_leaves(
    distance_fn: DistanceFn,
    domain: Box,
    limits: GivenLimits,
    reach: Reach | None,
    proof: Proof,
    seed: int,
    options: BuildOptions,
    leaf: LeafModel | str,
    root: CellSources | None = None,
) -> DecodedFile:
    """Build a PLR with the leaf model ``leaf``, and return the content of its file.

    ``reach`` tells from where the goal can be reached, if known. ``proof`` is the kind of error bounds to prove.
    ``root``, if known, has the corners (or the goal) to which shortest paths from points of the domain may go first.
    """
    # 1. Check the arguments. Cones, proofs, and distance functions that answer for cells are not folded.
    model = leaf_model(leaf, "best")
    model.check_domain(domain)
    table_corners(domain)  # raises if 32-bit queries cannot represent the domain
    require_integer("seed", seed, 0)
    cell_sources = getattr(distance_fn, "cell_sources", None)
    if proof is not Proof.NONE:
        require_certifiable(distance_fn, domain)
    may_fold = proof is Proof.NONE and not isinstance(model, Cone) and cell_sources is None
    folding = folding_of(distance_fn, domain) if may_fold else None
    reach = None if folding is not None else reach
    has_border = reach is not None and bool(reach.is_border(*Cells.root(domain.dim).fractions)[0])
    if limits == GivenLimits() and domain.dim > 2 and has_border:
        limits = GivenLimits(max_leaves=_LEAVES_OF_VOLUMES)
    checked = check_limits(model, domain.dim, proof, frame_size(domain, folding), limits)
    num_samples = model.num_samples if options.num_samples is None else options.num_samples
    require_integer("num_samples", num_samples, model.min_samples(domain.dim))

    # 2. Wrap the distance function: cell sources, workers, folded points.
    cache = None
    if cell_sources is not None and domain.dim == 2:
        cache = SourceCache(domain, cell_sources(grown_domain(domain)) if root is None else root)
    weight_fn = options.weight_fn
    if options.executor is not None:
        distance_fn = partial(sampling.parallel_distances, distance_fn, options.executor)
    if folding is not None:
        domain, weight_fn = folding.box, partial(sampling.folded_weights, weight_fn, folding)
        distance_fn = partial(sampling.folded_distances, distance_fn, folding)

    # 3. Grow the partition.
    rule = options.compute_coefficients
    for factor in _SAMPLE_FACTORS:  # more samples if hardly one reaches the goal
        counts = (min(k * int(num_samples), _MAX_SAMPLES) for k in (factor, max(factor, _DENSE_FACTOR)))
        pattern, dense = (sampling.sample_pattern(domain.dim, k, float(options.margin), int(seed)) for k in counts)
        sampler = Sampler(distance_fn, domain, weight_fn, pattern, dense, checked.max_axis_depth, rule, cache, reach)
        seen = sampler(Cells.root(domain.dim)).reachable
        if reach is not None or seen.sum() > sampling.few_samples(domain.dim):
            break
    sampler = replace(sampler, is_sparse=bool(seen.mean() < _SPARSE))
    tree, stored, visible = model.construct(sampler, Rules(options.should_split, options.split), checked)
    model = leaf_model(model.name)  # files store no options of a model
    contents = DecodedFile(domain, model, tree, stored, folding=folding, cut_off=cut_off_leaves(reach, tree))

    # 4. Prove its error bounds.
    if proof is not Proof.NONE and cache is not None:
        try:
            visible = cache.sources_of_leaves(tree) if visible is None else visible
            contents = replace(contents, certificate=certificates_of([contents], visible, proof)[0])
        except KeyboardInterrupt:
            message = "Interrupted during the proof: the PLR is complete, but has no certificate."
            warnings.warn(message, ConstructionInterrupted, stacklevel=3)
    return contents


def proof_of(certified: bool | str) -> Proof:
    if isinstance(certified, str) and certified == "leaves":
        return Proof.LEAVES
    if not isinstance(certified, bool | np.bool):
        raise ValueError(f"certified must be True, False or 'leaves', got {shortened(certified)}.")
    return Proof.CLASSES if certified else Proof.NONE


def warn_if_cut_off(reach: Reach | None, contents: DecodedFile) -> None:
    """Warn if most of free space is cut off from the goal, or if the PLR answers a finite number at cut-off points.

    The second warning ignores cut-off points that are close to points from which the goal can be reached. If
    ``reach`` is None, cut-off points are unknown, and there are no warnings.
    """
    if reach is None:
        return
    dim = contents.domain.dim
    lo, hi = contents.tree.leaves.fractions
    try:
        # 1. Find the leaves with finite answers and cut-off points.
        is_finite = np.isfinite(filled_coefficients(contents)[:, 0])
        is_wrong = is_finite & (reach.is_border(lo, hi) | reach.is_cut_off(lo, hi))
        lo, hi = lo[is_wrong], hi[is_wrong]
        # 2. Divide each into _PARTS**dim equal boxes, whose lower corners are ``part``; add up the volumes of boxes
        #    with cut-off points far from all points that reach the goal. All are in fractions of the domain.
        steps = np.moveaxis(np.indices((_PARTS,) * dim), 0, -1).reshape(-1, dim)
        part = lo[:, None] + (hi - lo)[:, None] * steps / _PARTS
        size = np.broadcast_to((hi - lo)[:, None] / _PARTS, part.shape).reshape(-1, dim)
        part = part.reshape(size.shape)
        wrong = size[reach.far(part, part + size)].prod(axis=1).sum()
        cut_off = reach.cut_off_fraction(dim)
    except KeyboardInterrupt:  # the PLR is complete without these warnings
        return
    if wrong > 0:
        message = f"In up to about {100 * wrong:.2g} % of the domain, the PLR answers a finite number, but no path"
        warnings.warn(f"{message} leads to the goal. Allow more bytes or leaves.", stacklevel=3)
    if cut_off > 0.5:
        message = f"The goal cannot be reached from about {cut_off:.0%} of free space: is the goal in the right part?"
        warnings.warn(message, stacklevel=3)


def build_best_model(
    build: Callable[[str], DecodedFile], names: list[str], error_of: Callable[[DecodedFile], float]
) -> DecodedFile:
    """Build a PLR with each leaf model in ``names``, and return the file content of the PLR with the smallest error.

    After Ctrl-C, choose among the PLRs built so far. If no model can be built, raise the ``ValueError`` of the model
    that needs the fewest bytes; if no error states this number, raise the first error.
    """
    # 1. Build the models. An interrupt ends a build with a warning and what was built so far; it also ends this loop.
    built: dict[str, DecodedFile] = {}
    errors: dict[str, float] = {}
    refused: list[ValueError] = []
    is_interrupted = False
    with Progress("construct", "leaf models", len(names)) as progress:
        try:
            for name in names:
                progress.update(bool(built or refused), name)
                try:
                    with warnings.catch_warnings(record=True) as caught:
                        warnings.simplefilter("always", ConstructionInterrupted)
                        built[name] = build(name)
                except ValueError as refusal:  # for example, a budget too small for one leaf
                    refused.append(refusal)
                    continue
                for warning in caught:  # the warning of an interrupt is given once, at the end
                    if issubclass(warning.category, ConstructionInterrupted):
                        is_interrupted = True
                    else:
                        warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
                errors[name] = error_of(built[name]) if len(names) > 1 else 0.0
                if is_interrupted:
                    break
        except KeyboardInterrupt:
            if not built:
                raise
            is_interrupted = True
    # 2. Return the best one.
    if not built:
        raise min(refused, key=lambda error: getattr(error, "num_bytes", math.inf))
    if is_interrupted:
        warnings.warn("Interrupted: the PLR is the best one built so far.", ConstructionInterrupted, stacklevel=3)
    return built[min(built, key=lambda name: errors.get(name, math.inf))]


def _models_to_try(
    root: CellSources | None, domain: Box, proof: Proof, max_bytes: int | None, only_bytes: bool
) -> list[str]:
    """Return the names of the leaf models that ``leaf="best"`` builds: see :func:`construct`.

    ``root`` has the corners to which shortest paths from points of the domain may go first; None if they are unknown.
    ``only_bytes`` tells whether ``max_bytes`` is the only limit and all rules are the defaults.
    """
    # On all maps of the experiments, cones had at least 10 times smaller mean errors than other leaves if all corners
    # took at most _ROOMY * max_bytes. Above _CROWDED * max_bytes, a few cones could err far more than others.
    others = ["plane", "continuous", "smooth"]
    if proof is Proof.NONE:
        others = ["continuous" if domain.dim <= leaf_model("continuous").max_dim else "plane"]
    if root is None:
        return others
    corner_bytes = _BYTES_A_SOURCE * np.count_nonzero(np.isfinite(root.sources.distances))
    corner_fraction = corner_bytes / max_bytes if isinstance(max_bytes, int | float) and max_bytes > 0 else 0.0
    if corner_fraction <= _ROOMY and only_bytes:
        return ["cone"]
    if proof is Proof.NONE and corner_fraction <= _CROWDED:
        others.append("smooth")
    return [*others, "cone"] if corner_fraction <= _CROWDED else others


def _error_of(distance_fn: DistanceFn, proof: Proof, seed: int, contents: DecodedFile) -> float:
    """Return a PLR's largest proven error or, without proofs, its error at random points.

    The error at random points is the geometric mean of the mean and the largest error at these points.
    """
    if proof is not Proof.NONE:  # an interrupted build has no certificate
        return math.inf if contents.certificate is None else contents.certificate.max_error
    domain = contents.domain
    x = domain.lo + domain.width * np.random.default_rng(seed).random((_ERROR_POINTS, domain.dim))
    distance = as_distances("The distance function", distance_fn(x), x)
    reached = np.isfinite(distance)
    errors = np.abs(NumpyPLR(encode(contents))(x[reached]) - distance[reached])
    return float(np.sqrt(errors.mean() * errors.max())) if len(errors) else 0.0


def certify(plr: "PLR", oracle: DistanceFn, *, leaf_bounds: bool = False) -> "PLR":
    """Prove bounds of the error of an existing PLR at all points of its domain that reach the goal.

    Return a copy of the PLR with this proof instead of any earlier proof: see :attr:`PLR.max_error` and
    :meth:`PLR.bounds`. The proof samples no points. It needs an oracle that *answers for whole cells*: for each cell,
    the oracle knows to which corners shortest paths from points of the cell may go first. Errors of the oracle itself
    are not included. If two parts of free space touch only at a point, the distance may jump there. A cell that
    covers both parts has a proven error of at least half of the jump.

    Args:
        plr: A PLR in the plane, of any leaf model.
        oracle: The distance function, one that answers for whole cells, such as ``VisibilityGraph``.
        leaf_bounds: True stores bounds of every leaf, 2 bytes each. False stores bounds that groups of leaves share,
            in at most 1/128 of the bytes of the leaves. If 1/128 is less than 10 bytes, only the largest error is
            stored.

    Raises:
        ValueError: If ``plr`` is no PLR in the plane or is folded; its domain is periodic, or too far from the origin
            for a proof; ``leaf_bounds`` is no bool; the oracle does not answer for cells; or a leaf stores ``inf``
            although some of its points reach the goal.
    """
    from plr_jax.plr._plr import PLR, plr_of_leaves  # imports JAX

    if not isinstance(plr, PLR):
        raise ValueError(f"plr must be a PLR, got {shortened(plr)}. Build one with construct.")
    if plr.tables.folding is not None:
        message = "plr must not be folded by symmetries of its distance function, got a folded PLR"
        raise ValueError(f"{message}. Build it with certified=True.")
    proof = Proof.LEAVES if as_bool("leaf_bounds", leaf_bounds) else Proof.CLASSES
    root = require_certifiable(oracle, plr.domain)(grown_domain(plr.domain))
    visible = SourceCache(plr.domain, root).sources_of_leaves(plr._contents.tree)
    (certificate,) = certificates_of([plr._contents], visible, proof)
    return plr_of_leaves(replace(plr._contents, certificate=certificate, straight=None)).with_label(plr.label)


def require_certifiable(oracle: DistanceFn, domain: Box) -> Callable[[Box], CellSources]:
    """Return ``oracle.cell_sources`` if bounds can be proven for PLRs in ``domain``; else raise ``ValueError``.

    The domain must be in the plane, without periodic axes, and the oracle must answer for whole cells (see
    :func:`certify`).
    """
    hint = "Build the PLR without a proof and measure its error"
    if domain.dim != 2 or (cell_sources := getattr(oracle, "cell_sources", None)) is None:
        raise ValueError(f"A proof needs {NEEDED}, got a {type(oracle).__name__} in {domain.dim} dimensions. {hint}.")
    if domain.is_periodic:
        raise ValueError(f"A proof needs Euclidean distances, without periodic axes, got {domain}. {hint}.")
    return cell_sources
