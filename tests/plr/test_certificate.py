"""Bounds of pieces and leaves, classes of leaves, and certificates as files keep them."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from piece_helpers import WORKSPACES, points_of

from plr_jax.geometry.box import Box
from plr_jax.oracles import VisibilityGraph
from plr_jax.plr.cell_memory import CellMemory
from plr_jax.plr.certificate import (
    Certificate,
    LeafBounds,
    LeafFunctions,
    Proof,
    classify_bounds,
    prove_bounds,
    read_certificate,
    read_classes,
    write_classes,
)
from plr_jax.plr.coding import BitReader, BitWriter
from plr_jax.plr.leaves import leaf_model
from plr_jax.plr.tree import Cells, grown_domain

# Bounds of pieces and of leaves, against distances of many points.


def sampled(oracle, visible, slope, intercept, rng, k):
    """Least and largest distance minus what the leaf holds that is met in each piece."""
    x = points_of(rng, visible.pieces, k)
    x += 1e-4 * (visible.center[:, None] - x)  # off the tips, past which the oracle sees
    contacts = oracle.workspace.boundary.vertices[oracle.workspace.boundary.contacts]
    at_contact = (np.linalg.norm(x[:, :, None] - contacts, axis=3) < 1e-7).any(axis=2)
    x = np.where(at_contact[:, :, None], 0.0, x)  # there the distance is that of the nearest side
    planes = intercept[visible.cell, None] + (slope[visible.cell, None] * x).sum(axis=2)
    met = np.where(at_contact, np.nan, oracle(x.reshape(-1, 2)).reshape(-1, k) - planes)
    return np.fmin.reduce(met, axis=1, initial=np.inf), np.fmax.reduce(met, axis=1, initial=-np.inf)


def sufficient(least, most, anew):
    return Certificate(1.0, None, Proof.LEAVES).sufficient_bounds(least, most, np.zeros(len(least)))


@pytest.mark.parametrize("kind", WORKSPACES)
def test_bounds_are_beyond_all_that_is_met_and_halving_brings_them_close(kind):
    """Of the sixteenths of a square."""
    rng, cells = np.random.default_rng(1), Cells.root(2)
    workspace = kind(rng)
    oracle = VisibilityGraph(workspace, workspace.sample_free(1, 1)[0])
    domain = Box((0, 0), (10, 10))
    memory = CellMemory(domain, oracle.cell_sources(grown_domain(domain)))
    for axis in (0, 1, 0, 1):
        memory.sources(cells)
        cells = cells.split(np.full(len(cells), axis))
    visible = memory.sources(cells)
    slope, intercept = rng.normal(size=(visible.num_cells, 2)) * 0.7, rng.normal(size=visible.num_cells)
    functions = LeafFunctions(leaf_model("plane"), 0 * slope - 1, 0 * slope + 1, np.column_stack([intercept, slope]))
    low, high = sampled(oracle, visible, slope, intercept, rng, 2000)
    lower, upper = functions.bounds_of_pieces(visible, visible.cell)
    assert (lower - visible.slack <= low).all() and (upper + visible.slack >= high).all()
    assert (upper - lower <= 40).all()
    errors = functions.largest_errors(visible)
    lower, upper = np.zeros(visible.num_cells), np.zeros(visible.num_cells)
    np.minimum.at(lower, visible.cell, low)
    np.maximum.at(upper, visible.cell, high)
    assert (errors >= np.maximum(-lower, upper) - visible.slack).all()
    assert ((errors > 0) == np.isin(np.arange(visible.num_cells), visible.cell)).all()
    bounds = prove_bounds(functions, visible, sufficient)
    assert (bounds.lower <= lower).all() and (bounds.upper >= upper).all()
    largest = max(upper.max(), -lower.min())
    assert (
        largest <= max(bounds.upper.max(), -bounds.lower.min()) <= 1.03 * largest
    )  # the samples do not meet the very largest
    spare = 0.1 * (upper - lower) + 0.01 * largest
    assert (bounds.lower >= lower - spare).all() and (bounds.upper <= upper + spare).all()
    nothing = oracle.cell_sources(Box((20, 20), (30, 30)))
    bounds = prove_bounds(functions, nothing, sufficient)
    assert bounds.lower.tolist() == [-nothing.slack] and bounds.upper.tolist() == [nothing.slack]
    assert oracle.workspace.tolerance <= nothing.slack


PROOFS = st.sampled_from([Proof.CLASSES, Proof.LEAVES, Proof.OPEN_LEAVES])


def written(certificate):
    body = BitWriter()
    certificate.write(body)
    return body


@given(st.integers(0, 1000), st.floats(-12, 6), PROOFS)
def test_codes_are_rounded_outward_by_little_and_read_as_they_were_written(seed, scale, proof):
    """The largest error is a float above all bounds. Open leaves have no upper bound, the others theirs."""
    rng = np.random.default_rng(seed)
    below, above = -(10.0 ** (scale - 8 * rng.random(50))), 10.0 ** (scale - 8 * rng.random(50))
    below[:5], above[3:9] = 0.0, 0.0
    rounding = 10.0 ** (scale - 7) * rng.random(50)
    is_open = (rng.random(50) < 0.3) & (proof is Proof.OPEN_LEAVES)
    certificate = Certificate.of(LeafBounds(below, np.where(is_open, np.inf, above)), rounding, proof)
    lower, upper = certificate.bounds()
    largest = max((rounding - below).max(), (rounding + above)[~is_open].max())
    if proof is Proof.CLASSES:
        np.testing.assert_array_equal([lower, upper], [[-certificate.max_error], [certificate.max_error]])
    else:
        assert (np.isinf(upper) == is_open).all()
        assert (lower <= below - rounding).all() and (upper >= above + rounding).all()
        assert (lower >= 1.0601 * (below - rounding) - 6e-7 * largest).all()
        assert (upper <= 1.0601 * (above + rounding) + 6e-7 * largest)[~is_open].all()
    np.testing.assert_array_equal(np.float32([lower, upper]), [lower, upper])
    found = certificate.max_error if proof is not Proof.OPEN_LEAVES else certificate.scale
    assert (
        largest <= found <= largest * (1.07 if proof is Proof.OPEN_LEAVES else 1 + 1e-6)
        and np.float32(found) == found
    )
    assert certificate.max_error == (np.inf if is_open.any() else found)
    body = written(certificate)
    assert body.num_bits == proof.num_bits(50, 0)
    again = read_certificate(BitReader(body.to_bytes()), proof, 50, 2)
    assert again is not None and again.proof is proof is certificate.proof
    assert again.max_error == certificate.max_error
    np.testing.assert_array_equal(again.bounds(), certificate.bounds())


def test_a_straight_line_is_kept_and_refused_if_it_makes_no_sense():
    straight = np.array([0.5, 0.25, 1.0, 2.0**-20])
    certificate = Certificate(1.0, np.zeros((2, 3), np.uint8), Proof.OPEN_LEAVES, straight)
    again = read_certificate(BitReader(written(certificate).to_bytes()), Proof.OPEN_LEAVES, 3, 2)
    assert again is not None and again.scale == 1.0
    np.testing.assert_array_equal(again.straight, straight)
    for wrong in (np.nan, np.inf, -1.0):
        body = written(replace(certificate, straight=np.append(straight[:3], wrong)))
        with pytest.raises(ValueError, match="a straight line to the goal with numbers that are none"):
            read_certificate(BitReader(body.to_bytes()), Proof.OPEN_LEAVES, 3, 2)


def test_nothing_above_zero_and_leaves_that_are_all_open_are_a_proof_too():
    certificate = Certificate.of(LeafBounds(np.zeros(3), np.zeros(3)), np.zeros(3), Proof.LEAVES)
    assert 0 < certificate.max_error < 1e-37
    assert (certificate.bounds()[1] >= 0).all()
    certificate = Certificate.of(LeafBounds(np.zeros(3), np.full(3, np.inf)), np.zeros(3), Proof.OPEN_LEAVES)
    lower, upper = certificate.bounds()
    assert (upper == np.inf).all() and (lower <= 0).all() and (lower > -1e-37).all()
    assert certificate.max_error == np.inf


@pytest.mark.parametrize(
    ("proof", "value"),
    [(Proof.LEAVES, -1.0), *((Proof.CLASSES, value) for value in (0.0, -0.0, np.nan, np.inf, -np.inf, 3.4e38))],
)
def test_a_largest_error_that_makes_no_sense_or_is_cut_short_is_refused(proof, value):
    with pytest.raises(ValueError, match="states a largest error of"):
        read_certificate(BitReader(BitWriter().write_floats(np.array([value])).to_bytes()), proof, 0, 2)
    body = BitWriter().write_floats(np.array([0.5])).write(np.arange(5), 8)
    with pytest.raises(ValueError, match="end too early"):
        read_certificate(BitReader(body.to_bytes()), Proof.LEAVES, 3, 2)


# Classes of leaves, against all partitions of few leaves, and as a file keeps them.


FACTOR = 2.0 ** ((np.arange(256) - 255) / 12)


def written_classes(codes):
    body = BitWriter()
    write_classes(body, codes)
    return body


@given(st.integers(0, 10_000), st.integers(1, 400), st.integers(0, 3000))
def test_no_leaf_is_in_a_class_of_lower_codes_all_keep_their_room_and_are_read_as_written(seed, num_leaves, room):
    """Most codes are small, some large."""
    rng = np.random.default_rng(seed)
    codes = rng.geometric(0.03, (2, num_leaves)) + 150 * (rng.random((2, num_leaves)) < 0.02)
    codes = np.clip(codes, 0, 255)
    found = classify_bounds(codes, FACTOR, rng.random(num_leaves), room)
    assert (found >= codes).all()
    np.testing.assert_array_equal(found.max(axis=1), codes.max(axis=1))
    assert written_classes(found).num_bits <= room or (found == found[:, :1]).all()
    assert np.unique(found, axis=1).shape[1] <= 16
    count = 1 + seed % 16
    for some in (found, rng.integers(256, size=(2, count))[:, rng.integers(count, size=num_leaves) ** 2 // count]):
        np.testing.assert_array_equal(read_classes(BitReader(written_classes(some).to_bytes()), num_leaves), some)


@pytest.mark.parametrize("seed", range(5))
def test_two_classes_are_the_best_two(seed):
    """With room for two of few leaves, no other cut of the range of codes has a smaller mean width."""
    rng = np.random.default_rng(seed)
    codes, volume = np.where(rng.random(200) < 0.03, 255, rng.integers(20, 40, (2, 200))), rng.random(200)
    found = classify_bounds(codes, FACTOR, volume, 130)
    assert np.unique(found, axis=1).shape[1] == 2
    key = codes.max(axis=0)
    for _, cut in pairwise(np.unique(key)):
        upper = key >= cut
        classes = np.where(upper, codes[:, upper].max(axis=1)[:, None], codes[:, ~upper].max(axis=1)[:, None])
        widths = [volume @ FACTOR[each].sum(axis=0) for each in (found, classes)]
        assert written_classes(classes).num_bits > 130 or widths[0] <= widths[1]


@pytest.mark.parametrize("seed", range(20))
def test_classes_stay_as_far_as_they_hold_and_what_is_enough_is_within_them(seed):
    """Most leaves are as before, some are new; now and then one is worse than all before."""
    rng = np.random.default_rng(seed)
    error, rounding = rng.uniform(1e-4, 2e-4, 5_000), np.full(5_000, 1e-9)
    error[:20] = rng.uniform(0.05, 0.1, 20)
    error[0] = 0.1
    before = Certificate.of(LeafBounds(-error, error), rounding, Proof.CLASSES, 1.0, 8_000)
    new = rng.permutation(5_000)[:300]
    error[new] = rng.uniform(1e-5, 2e-4, 300)
    error[:2] = 0.1, 0.01 if seed % 4 else 0.2
    after = Certificate.of(LeafBounds(-error, error), rounding, Proof.CLASSES, 1.0, 8_000, before)
    lower, upper = after.bounds()
    assert (lower <= -error - rounding).all() and (upper >= error + rounding).all()
    classes = {tuple(each) for each in before.bounds().T.tolist()}
    stay = {tuple(each) for each in after.bounds().T.tolist()} <= classes
    assert stay == (after.scale == before.scale) == (error.max() <= 0.1)
    if stay:
        low, high = before.sufficient_bounds(-error, error, rounding)
        spare = 1.01e-3 * before.scale
        assert ((low >= lower + rounding) | (low >= -error - spare)).all() and (low <= -error).all()
        assert ((high <= upper - rounding) | (high <= error + spare)).all() and (high >= error).all()
        assert np.mean(high > error + spare) > 0.001  # of leaves that need no better bound than their class has


def test_leaves_that_do_not_exist_and_data_that_end_are_refused():
    data = written_classes(np.array([[0, 9, 9, 9], [3, 5, 5, 5]])).to_bytes()
    for cut, num_leaves, message in ((data, 0, "names"), (data[:-1], 4, "end too early")):
        with pytest.raises(ValueError, match=message):
            read_classes(BitReader(cut), num_leaves)
