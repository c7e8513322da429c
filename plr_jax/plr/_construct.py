"""Building a PLR: Algorithm 1 of the paper, for any leaf model."""

import os
import warnings
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace
from functools import wraps
from inspect import signature
from typing import TYPE_CHECKING, Any, ParamSpec

import numpy as np

from plr_jax._arrays import as_bool, as_number, require_function, require_integer
from plr_jax._types import ArrayLike, CellwiseFn, ChangingFn, DistanceFn, FreeSpaceFn
from plr_jax.geometry.box import Box
from plr_jax.plr._best import BEST, best_leaves
from plr_jax.plr._certify import require_certifiable
from plr_jax.plr._checkpoint import Checkpoint, digest_of
from plr_jax.plr._file import Contents
from plr_jax.plr._proof import Origin, can_be_updated, certificate_of
from plr_jax.plr.certificate import Proof
from plr_jax.plr.container import frame_size
from plr_jax.plr.folding import folding_of
from plr_jax.plr.frame import table_corners
from plr_jax.plr.growth.best_first import ShouldSplitRule, SplitRule, best_axis, largest_error
from plr_jax.plr.growth.limits import ConstructionInterrupted, check_limits
from plr_jax.plr.leaves import leaf_model
from plr_jax.plr.leaves.base import LeafModel, Rules, SourcedLeafModel
from plr_jax.plr.partition.cells import Cells, levels_of
from plr_jax.plr.sampling.asked import AskedFn, as_executor
from plr_jax.plr.sampling.cell_fit import FitRule, Sampler, WeightFn, least_squares, sample_pattern
from plr_jax.plr.sampling.cell_memory import CellMemory
from plr_jax.plr.sampling.folded import FoldedFn, FoldedWeights

if TYPE_CHECKING:
    from plr_jax.plr._plr import PLR

_DENSER = 8  # times as many samples where the first ones hardly meet what is free
_MOST_SAMPLES = 2**16
_DRAWN = 1000  # points of the domain, to see how many reach the goal
Arguments = ParamSpec("Arguments")


def _assembled(leaves_of: Callable[Arguments, Contents]):
    """What gives leaves, as what gives the PLR of them, which alone needs JAX."""

    @wraps(leaves_of)
    def construct(*args: Arguments.args, **kwargs: Arguments.kwargs) -> "PLR":
        from plr_jax.plr._plr import plr_of_leaves

        given = signature(leaves_of).bind(*args, **kwargs).arguments
        plr = plr_of_leaves(contents := leaves_of(*args, **kwargs))
        if can_be_updated(contents) and isinstance(given["distance_fn"], ChangingFn):
            limits = (given.get(name) for name in ("max_bytes", "max_leaves", "tolerance"))
            vars(plr)["_origin"] = Origin(given["distance_fn"], *limits)
        return plr

    vars(construct)["__signature__"] = signature(leaves_of).replace(return_annotation="PLR")
    return construct


def _with_advice(leaves_of: Callable[Arguments, Contents]):
    """What gives leaves of a model, as what gives the best of several as well, and tells if the goal seems wrong."""

    @wraps(leaves_of)
    def construct(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Contents:
        given = signature(leaves_of).bind(*args, **kwargs)
        given.apply_defaults()
        options: dict[str, Any] = given.arguments | {"domain": Box.of(given.arguments["domain"])}
        if options["leaf"] != BEST:
            contents = leaves_of(*args, **kwargs)
        else:
            best = best_leaves(leaves_of, **options)
            contents = best.contents
            if best.is_interrupted:
                message = "Interrupted: the PLR is the best one built so far."
                warnings.warn(message, ConstructionInterrupted, stacklevel=3)
        distance_fn = options["distance_fn"]
        if isinstance(distance_fn, FreeSpaceFn) and (advice := _of_cut_off(distance_fn, options["domain"])):
            warnings.warn(advice, stacklevel=3)
        return contents

    return construct


def _of_cut_off(distance_fn: FreeSpaceFn, domain: Box) -> str | None:
    """What to say if most free points do not reach the goal."""
    x = domain.lo + domain.width * np.random.default_rng(0).random((_DRAWN, domain.dim))
    try:
        x = x[np.asarray(distance_fn.is_free(x))]
        cut_off = np.count_nonzero(np.isinf(np.ma.filled(distance_fn(x), np.inf))) if len(x) else 0
    except KeyboardInterrupt:  # all is built
        return None
    if 2 * cut_off <= len(x):
        return None
    return (
        f"The goal cannot be reached from {100 * cut_off / len(x):.0f} % of {len(x):,} free points of the domain. Is "
        "it in the part of free space that you mean? What the PLR answers in the others means nothing."
    )


@_assembled
@_with_advice
def construct(
    distance_fn: DistanceFn,
    domain: Box | tuple[ArrayLike, ArrayLike],
    *,
    leaf: LeafModel | str = "plane",
    max_depth: int | None = None,
    max_leaves: int | None = None,
    max_bytes: int | None = None,
    tolerance: int | float | None = None,
    certified: bool = False,
    leaf_bounds: bool = False,
    compute_coefficients: FitRule = least_squares,
    should_split: ShouldSplitRule = largest_error,
    split: SplitRule = best_axis,
    num_samples: int | None = None,
    margin: int | float = 0,
    weight_fn: WeightFn | None = None,
    seed: int = 0,
    executor: Executor | None = None,
    checkpoint: str | os.PathLike | None = None,
) -> Contents:
    """Build a PLR of a distance function: Algorithm 1 of the paper.

    Most calls give a budget, ``max_bytes``, and a leaf: ``"cone"`` for distances among polygons, as of a
    ``VisibilityGraph``, with ``certified=True`` for proven bounds; ``"plane"``, the paper's, or ``"continuous"`` for
    any other. ``executor`` and ``checkpoint`` are for distance functions that take long. All else is for experiments
    with the algorithm itself: its rules of fitting and splitting, samples, and other limits.

    The default is best-first: the leaf of the largest sample error is split next, along the axis whose halves
    can be fitted best. The paper's own configuration is ``should_split=maximum_depth`` (or ``center_error`` with
    a tolerance), ``split=cyclic_axis``, ``max_depth=9``.

    Of a distance function that states ``symmetries``, as ``ReedsShepp`` and ``Euclidean`` do, a domain that they
    map onto itself in part is *folded*: points are mirrored into a smaller box, ``folded_domain``, and only that is
    partitioned and stored. Those are used that are reflections along common axes, none of which mixes a periodic axis
    with others, and that make the box smaller than the domain. This is part of
    the file, and a query undoes it. It is not done for cones, for ``certified`` PLRs, nor for distance functions that
    answer for whole cells.

    Any limits may be combined; construction stops at the first that is met. Without any, at 512 leaves.

    Args:
        distance_fn: Distance to the goal for a batch of points ``(n, dim)``; ``inf`` (or a masked entry) where it
            cannot be reached.
        domain: The box to cover, a ``Box`` or its two corners. Along its periodic axes the distance function is to be
            periodic itself. It is asked for points of the box, and around it if that is turned to be folded. Tied
            leaves do not jump at the seam either.
        leaf: What a leaf holds. ``"best"`` is cones where ``max_bytes`` has room for all corners of a map; where it
            has not, those of cones (if a quarter of the corners has room) and continuous leaves whose mean error is
            least, at points of the domain; of other distance functions continuous leaves, or planes in more than 6
            dimensions. With ``certified`` it is the model of the least proven error. ``"plane"``, the paper's, may
            jump from leaf to leaf. ``"continuous"`` stores values at the leaves' corners, shared by all leaves that
            meet there without a wall between them, and is multilinear in every leaf: it does not jump where one can
            walk, in up to 6 dimensions. ``"smooth"`` has a continuous gradient as well, in 1 or 2 dimensions. Both
            take longer to build and to query, and err less for their bytes. ``"cone"`` holds the distance to one
            *source*, a point that paths go to next, and on from there: among obstacles that is exact but where the
            next corner changes, if the file has room for the corners, some 7 bytes each; where it has room for less
            than a quarter, as of a scan full of specks, others mostly err less. Cones need a distance function
            that answers for whole cells of the plane, as ``VisibilityGraph`` does: their partition is the best of all
            at a price a leaf, its boxes up to 4 times as long as wide in fractions of the domain, and samples only
            choose among sources that serve a leaf about as well. Cones answer finite numbers wherever they are asked.
            Or a leaf model, such as ``plr_jax.plr.Plane(coefficient_bits=16)``.
        max_depth: Largest number of splits between the root and a leaf, at most 60. In any case no cell is halved
            more often along one axis than the tables of a query of that size provide for. In the plane:

            - planes 7 times up to 2,048 bytes, 8 up to 8,192, 9 up to 32,768, or 13 if ``certified``;
            - tied leaves, which are the continuous and the smooth, the same in half the bytes;
            - cones 13 times up to 8,192 bytes;
            - all of them 14 times beyond.

            On a line twice as often up to these sizes, if not certified, and 18 times beyond. In ``dim`` > 2
            dimensions ``28 // dim`` times. That size is the smaller of ``max_bytes`` and what ``max_leaves`` count:
            tied ones 2 bytes each; planes ``4 * (dim + 1)``, but 32,768 in all at the least; cones half a byte each,
            and 256 in all. Tables of PLRs of as many planes may differ in size.
        max_leaves: Largest number of leaves.
        max_bytes: Largest size of the file that :func:`save` writes. Planes then have as few bits as serves the
            error best; without it they are 32-bit floats, in several times the bytes. No more leaves than half as
            many as the bytes, of tied ones than as many, of cones than twice as many.
        tolerance: Cells whose priority (the largest sample error, unless ``should_split`` says otherwise) is at
            most this are not split, in units of distance. With ``max_bytes``, of any size, the file is smaller. Of
            cones, and of planes with ``certified``, it is the proven error of the leaf.
        certified: Whether to prove a bound of the largest error, over all points from which the goal can be reached:
            ``plr.max_error``, 4 bytes of the file. PLRs of more than 1,300 bytes keep bounds of classes of leaves as
            well, in less than a 100th of these: most leaves are far better than the worst one, and so ``plr.bounds``
            is far narrower. The plane of the largest proven error is then split first, unless
            ``should_split`` says otherwise, and the best partition of cones weighs large errors more, so that nothing
            is missed, however small. Tied leaves grow by their samples and are proven afterwards: where samples
            missed something, their bound is large. For distance functions that answer for whole cells; see
            :func:`certify`.
        leaf_bounds: Whether the proof has bounds of every leaf, 2 bytes each, instead of those of its class.
        compute_coefficients: Plane of a cell: ``least_squares``, or your own function of its kind. Models that tie
            their leaves fit all of them at once instead.
        should_split: Priority of a cell: ``largest_error``, ``center_error``, ``maximum_depth`` or your own function
            of a ``CellFit``, from which the cell of the largest positive number is split next (True and False do).
        split: Axis along which to halve a cell: ``best_axis``, ``cyclic_axis`` or your own function of a ``CellFit``.
        num_samples: Samples of a cell, at its center, inside and on its faces; None: 192 for planes, 96 for the
            others. At least ``dim + 1`` for planes, with which a plane passes through its samples and shows no error,
            and ``2**dim + 1`` for the others: take several times as many. At most 65,536.
        margin: How far samples reach beyond their cell, as a fraction from 0 to 1 of its width ("within or near the
            cell"). Averages the noise of an oracle such as a roadmap.
        weight_fn: Weight of the error at each of a batch of points, finite and >= 0; where accuracy matters.
        seed: Seed of the samples' scrambling. The same seed gives the same PLR.
        executor: What asks ``distance_fn``, for 1,024 points at a time: threads, processes, a cluster's. For one that
            takes long and, of processes, is picklable. Any number of workers gives the same PLR, and the same as
            none if what it says of a point does not depend on the others. None: this process.
        checkpoint: A file in which answers of ``distance_fn`` are kept, 8 bytes each. Called again for the same
            ``distance_fn`` and domain, construction asks only for the others, even if the process was killed, and
            gives the same PLR. It is known by what it says of 256 points. None: none. ``VisibilityGraph``, or another
            one that answers for whole cells, needs neither an executor nor a checkpoint: that takes seconds.

    Returns:
        The PLR. If interrupted (Ctrl-C) once there is a leaf, the one built so far, with a
        ``ConstructionInterrupted`` warning; if in its proof, the whole one without a proof. Another warning says if
        most free points do not reach the goal, where ``distance_fn`` tells (``is_free``), as those of maps do.

    Raises:
        ValueError: If an argument is out of its range, the leaf model is not for so many dimensions, the limits allow
            a tree larger than memory, a budget is too small for one leaf, tied leaves hang on one another in too many
            ways (of hundreds in 6 dimensions), ``distance_fn`` returns a wrong shape or NaN, no sample reaches the
            goal, cones or a proof are asked for and ``distance_fn`` does not answer for cells, they are asked for
            in a domain with a periodic axis, or the checkpoint is of another ``distance_fn`` or domain.
        OSError: If the checkpoint cannot be read or written.

    References:
        Section III-B of the paper. For ``"smooth"``: Bogner, Fox, Schmit, "The generation of inter-element-compatible
        stiffness and mass matrices by the use of interpolation formulas", 1965. For the best partition: Donoho, "CART
        and best-ortho-basis: a connection", Annals of Statistics 1997.
    """
    domain, model = Box.of(domain), leaf_model(leaf)
    model.check_dim(domain.dim)
    table_corners(domain)  # or a query could not hold them
    folding = None
    if not (certified or isinstance(model, SourcedLeafModel) or isinstance(distance_fn, CellwiseFn)):
        folding = folding_of(distance_fn, domain)
    proof = proof_of(certified, leaf_bounds)
    if proof is not Proof.NONE:
        require_certifiable(distance_fn, domain)
    limits = check_limits(
        domain.dim,
        model.least_bytes,
        model.has_deep_trees or proof is not Proof.NONE,
        model.bytes_without_budget,
        max_depth,
        max_leaves,
        max_bytes,
        tolerance,
        proof,
        frame_size(domain, folding),
    )
    num_samples = model.num_samples if num_samples is None else num_samples
    require_integer("num_samples", num_samples, model.least_samples(domain.dim))
    if num_samples > _MOST_SAMPLES:
        raise ValueError(f"num_samples must be at most {_MOST_SAMPLES:,} a cell, got {num_samples:,}.")
    margin = as_number("margin", margin, "a fraction from 0 to 1 of a cell's width", lambda share: 0 <= share <= 1)
    require_integer("seed", seed, 0)
    functions: dict[str, object] = {
        "distance_fn": distance_fn,
        "compute_coefficients": compute_coefficients,
        "should_split": should_split,
        "split": split,
    }
    if weight_fn is not None:
        functions["weight_fn"] = weight_fn
    for name, function in functions.items():
        require_function(name, function)
    pattern, dense = (sample_pattern(domain.dim, n * int(num_samples), margin, int(seed)) for n in (1, _DENSER))
    memory = CellMemory(distance_fn, domain) if isinstance(distance_fn, CellwiseFn) and domain.dim == 2 else None
    if executor is not None or checkpoint is not None:
        kept = None if checkpoint is None else Checkpoint(checkpoint, digest_of([distance_fn], domain, "answers"))
        distance_fn = AskedFn(distance_fn, as_executor(executor), kept)
    if folding is not None:
        domain, weight_fn = folding.box, FoldedWeights(weight_fn, folding)
        distance_fn = FoldedFn(distance_fn, folding)
    sampler = Sampler(
        distance_fn, domain, weight_fn, pattern, dense, limits.max_axis_depth, compute_coefficients, memory
    )
    cells, stored = model.construct(sampler, Rules(should_split, split), limits)
    as_loaded = leaf_model(model.name)  # without options of the construction, which no file knows
    contents = Contents(domain, as_loaded, levels_of(cells)[0], cells, stored, folding=folding)
    if proof is not Proof.NONE and memory is not None:
        root = memory.sources(Cells.root(domain.dim))
        try:
            contents = replace(contents, certificate=certificate_of(contents, root, proof))
        except KeyboardInterrupt:
            message = "Interrupted in its proof: the PLR is as it was to be, but nothing is proven of it."
            warnings.warn(message, ConstructionInterrupted, stacklevel=4)
    return contents


construct_leaves = construct.__wrapped__
"""The same, which gives what the file of the PLR holds: JAX is not imported."""


def proof_of(certified: bool, leaf_bounds: bool) -> Proof:
    """What is to be proven."""
    certified, leaf_bounds = as_bool("certified", certified), as_bool("leaf_bounds", leaf_bounds)
    if leaf_bounds and not certified:
        raise ValueError("leaf_bounds=True needs certified=True: bounds of leaves are a part of the proof.")
    return Proof.LEAVES if leaf_bounds else Proof.CLASSES if certified else Proof.NONE
