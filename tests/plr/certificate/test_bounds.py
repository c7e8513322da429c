"""Bounds of pieces and of leaves, against distances of many points."""

from dataclasses import dataclass

import numpy as np
import pytest
from piece_helpers import WORKSPACES, points_of

from plr_jax.geometry.box import Box
from plr_jax.geometry.convex_pieces import cone_above_plane
from plr_jax.oracles import VisibilityGraph
from plr_jax.plr.cell_memory import CellMemory
from plr_jax.plr.certificate import bounds_of_pieces, prove_bounds, proven_errors
from plr_jax.plr.tree import Cells


@dataclass(frozen=True)
class Planes:
    """A plane in every leaf."""

    slope: np.ndarray
    intercept: np.ndarray

    def values(self, leaf, x):
        return (self.slope[leaf] * x).sum(axis=1) + self.intercept[leaf]

    def below_cones(self, leaf, pieces, apex, offset):
        return cone_above_plane(pieces, apex, offset, self.slope[leaf], self.intercept[leaf])


def sampled(oracle, visible, planes, rng, k):
    """Least and largest distance minus what the leaf holds that is met in each piece."""
    x = points_of(rng, visible.pieces, k)
    x += 1e-4 * (visible.center[:, None] - x)  # off the tips, past which the oracle sees
    contacts = oracle.workspace.boundary.vertices[oracle.workspace.boundary.contacts]
    at_contact = (np.linalg.norm(x[:, :, None] - contacts, axis=3) < 1e-7).any(axis=2)
    x = np.where(at_contact[:, :, None], 0.0, x)  # there the distance is that of the nearest side
    met = oracle(x.reshape(-1, 2)) - planes.values(np.repeat(visible.cell, k), x.reshape(-1, 2))
    met = np.where(at_contact, np.nan, met.reshape(-1, k))
    return np.fmin.reduce(met, axis=1, initial=np.inf), np.fmax.reduce(met, axis=1, initial=-np.inf)


@pytest.mark.parametrize("kind", WORKSPACES)
def test_bounds_are_beyond_all_that_is_met_and_halving_brings_them_close(kind):
    """Of the sixteenths of a square, whichever pieces are asked for."""
    rng, cells = np.random.default_rng(1), Cells.root(2)
    workspace = kind(rng)
    oracle = VisibilityGraph(workspace, workspace.sample_free(1, 1)[0])
    memory = CellMemory(oracle, Box((0, 0), (10, 10)))
    for axis in (0, 1, 0, 1):
        memory.sources(cells)
        cells = cells.split(np.full(len(cells), axis))
    visible = memory.sources(cells)
    planes = Planes(rng.normal(size=(visible.num_cells, 2)) * 0.7, rng.normal(size=visible.num_cells))
    low, high = sampled(oracle, visible, planes, rng, 2000)
    piece = rng.integers(len(visible.cell), size=40)

    def cones_above(pieces, apex, offset, row):
        return planes.below_cones(visible.cell[piece[row]], pieces, apex, offset)

    lower, upper = bounds_of_pieces(visible, piece, cones_above)
    assert (lower - visible.slack <= low[piece]).all() and (upper + visible.slack >= high[piece]).all()
    assert (upper - lower <= 40).all()
    assert [len(bound) for bound in bounds_of_pieces(visible, piece[:0], cones_above)] == [0, 0]

    def below_cones(slope, intercept, pieces, apex, offset):
        return cone_above_plane(pieces, apex, offset, slope, intercept[:, 0])

    errors = proven_errors(visible, below_cones, (planes.slope, planes.intercept[:, None]))
    lower, upper = np.zeros(visible.num_cells), np.zeros(visible.num_cells)
    np.minimum.at(lower, visible.cell, low)
    np.maximum.at(upper, visible.cell, high)
    assert (errors >= np.maximum(-lower, upper) - visible.slack).all()
    assert ((errors > 0) == np.isin(np.arange(visible.num_cells), visible.cell)).all()
    bounds = prove_bounds(planes, visible)
    assert (bounds.lower <= lower).all() and (bounds.upper >= upper).all()
    largest = max(upper.max(), -lower.min())
    assert largest <= bounds.largest <= 1.03 * largest  # the samples do not meet the very largest
    spare = 0.1 * (upper - lower) + 0.01 * largest
    assert (bounds.lower >= lower - spare).all() and (bounds.upper <= upper + spare).all()
    nothing = oracle.cell_sources(Box((20, 20), (30, 30)))
    bounds = prove_bounds(planes, nothing)
    assert bounds.lower.tolist() == [-nothing.slack] and bounds.upper.tolist() == [nothing.slack]
    assert oracle.workspace.tolerance <= nothing.slack
