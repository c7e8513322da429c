"""Sources and ranks of cones in files: on the lattice of a map, as parents of one another, read as written."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plr_jax import Box
from plr_jax.plr.coding import BitReader, BitWriter
from plr_jax.plr.leaves.cone.codec import (
    StoredCones,
    StoredSources,
    read_cones,
    store_sources,
    write_cones,
)

LATTICES = {"integers": 1.0, "hundredths": 0.01, "quarters": 0.25, "thirds": 1 / 3, "none": None}


def random_sources(rng, dim, count, lattice):
    """Sources of a tree whose roots are some of the first, with the distances along it."""
    step = LATTICES[lattice]
    points = np.unique(rng.integers(-300, 300, (count, dim)), axis=0).astype(float)
    points = points * step if step else points + rng.random(points.shape)
    points = rng.permutation(points)
    count = len(points)
    parents = np.array([rng.integers(max(i, 1)) for i in range(count)])
    parents[: 1 + count // 10] = np.arange(1 + count // 10)
    return points, distances_along(points, parents, rng.integers(9, size=count) / 8), parents


def distances_along(points, parents, of_roots):
    distances = of_roots + np.linalg.norm(points - points[parents], axis=1)
    for i in np.flatnonzero(parents < np.arange(len(points))):
        distances[i] += distances[parents[i]] - of_roots[i]
    return distances


def bits_of(domain, cones):
    body = BitWriter()
    write_cones(body, domain, cones)
    return body


@pytest.mark.parametrize("lattice", LATTICES)
@given(st.integers(0, 100_000), st.integers(1, 5), st.sampled_from([1, 2, 17, 60]))
def test_what_is_written_is_read(lattice, seed, dim, count):
    rng = np.random.default_rng(seed)
    points, distances, parents = random_sources(rng, dim, count, lattice)
    domain = Box(points.min(axis=0) - rng.random(dim), points.max(axis=0) + 10 * rng.random(dim) + 0.1)
    stored, index = store_sources(points, distances, parents, domain)
    source = index[rng.integers(len(points), size=int(rng.integers(1, 80)))]
    body = bits_of(domain, StoredCones(stored, source))
    reader = BitReader(body.to_bytes())
    found = read_cones(reader, domain, len(source))
    assert reader.at_end()
    np.testing.assert_array_equal(found.source, source)
    for name in ("code", "parent", "root_offset", "points", "offsets"):
        np.testing.assert_array_equal(getattr(found.sources, name), getattr(stored, name))
    width = domain.width.max()
    rounding = 1e-13 * (1 + np.abs(points).max()) if LATTICES[lattice] else 2.0**-25 * width
    assert np.abs(found.sources.points[index] - points).max() <= rounding
    assert len(np.unique(index)) == len(points)
    np.testing.assert_array_equal(found.sources.parent[index], index[parents])
    far = (1 + np.arange(len(points))) * 2 * rounding * np.sqrt(dim) + 1e-12 * (1 + distances)
    assert (np.abs(found.sources.offsets[index] - distances) <= far).all()


@pytest.mark.parametrize(
    ("lattice", "expected"), [("integers", 1), ("hundredths", 100), ("quarters", 4), ("thirds", 3), ("none", None)]
)
def test_the_lattice_of_a_map_is_found_and_points_on_none_are_kept_to_a_fine_step(lattice, expected):
    points, distances, parents = random_sources(np.random.default_rng(1), 2, 40, lattice)
    domain = Box((-300, -300), (700, 700))
    stored, _ = store_sources(points, distances, parents, domain)
    if expected is None:
        assert stored.num_fine == 40 and stored.exponent == -16
        assert len(bits_of(domain, StoredCones(stored, np.zeros(1, int))).to_bytes()) < 40 * 8
    else:
        assert stored.fraction == expected
        np.testing.assert_allclose(stored.points, np.unique(points, axis=0), atol=1e-13)


def test_sources_at_one_place_are_stored_once():
    points = np.array([[0.0, 0], [1, 1], [1, 1 + 1e-15], [0, 0]])
    distances = np.array([0, 2**0.5, 2**0.5, 0])
    stored, index = store_sources(points, distances, np.array([0, 0, 0, 3]), Box((0, 0), (2, 2)))
    assert index.tolist() == [0, 1, 1, 0]
    assert stored.parent.tolist() == [0, 0] and stored.is_root.tolist() == [True, False]
    np.testing.assert_allclose(stored.offsets, [0, 2**0.5])


def test_offsets_are_the_lengths_along_long_chains():
    """A spiral of a thousand turns, each after the one before, and the goal of 5 at its end."""
    points = np.column_stack([np.arange(1000), np.arange(1000) % 2]).astype(float)
    parents, distances = np.maximum(np.arange(1000) - 1, 0), 5 + np.sqrt(2) * np.arange(1000)
    stored, index = store_sources(points, distances, parents, Box((0, 0), (1000, 1)))
    np.testing.assert_allclose(stored.offsets[index], distances)


def test_ranks_are_few_bits_where_leaves_take_turns():
    """Leaves that alternate between two sources take two bits each, those that stay one."""
    domain = Box((0, 0), (200, 200))
    stored, _ = store_sources(np.arange(200.0).reshape(100, 2), np.zeros(100), np.arange(100), domain)
    ranks = np.full(1000, 77), 77 + np.arange(1000) % 2
    one, two = (bits_of(domain, StoredCones(stored, rank)).num_bits for rank in ranks)
    assert two - one < 1100 and one < 100 * 60 + 1100


@given(st.binary(max_size=400), st.integers(1, 5), st.integers(1, 300))
def test_arbitrary_bits_are_read_or_refused(data, dim, num_leaves):
    try:
        found = read_cones(BitReader(data), Box(np.zeros(dim), np.ones(dim)), num_leaves)
    except ValueError:
        return
    assert found.source.shape == (num_leaves,) and (found.source < len(found.sources.code)).all()
    assert np.isfinite(found.sources.offsets).all() and np.isfinite(found.sources.points).all()


DOMAIN = Box((0, 0), (8, 8))
# Three sources, each the parent of the next, as a file keeps them.
SOURCES = StoredSources(0, 0, 1, np.array([[0, 0], [1, 4], [2, 7]]), np.array([0, 0, 1]), np.zeros(3))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"parent": np.array([0, 2, 1])}, "circle"),
        ({"parent": np.array([0, 3, 1])}, "names source 3 of 3"),
        ({"num_fine": 3, "exponent": 300}, "steps of"),
        ({"num_fine": 3, "exponent": -300}, "steps of"),
        ({"num_fine": 3, "exponent": 150}, "too large"),
        ({"root_offset": np.array([np.nan, 0, 0])}, "too large"),
        ({"root_offset": np.array([np.inf, 0, 0])}, "too large"),
        ({"code": np.array([[0, 0], [1, 4], [2, 2**45]])}, "coordinates of 46 bits"),
    ],
)
def test_sources_that_make_no_sense_are_refused(changes, message):
    body = bits_of(DOMAIN, StoredCones(replace(SOURCES, **changes), np.zeros(4, int)))
    with pytest.raises(ValueError, match=message):
        read_cones(BitReader(body.to_bytes()), DOMAIN, 4)


@pytest.mark.parametrize(
    ("counts", "fraction", "rest", "message"),
    [
        ((0, 0), [], bytes(99), "no sources"),
        ((0, 1), [0], bytes(99), "steps of 1 / 0"),
        ((0, 2**20 - 1), [1], bytes(range(1, 30)), "end too early"),  # refused before they are made
    ],
)
def test_counts_and_steps_that_are_none_are_refused(counts, fraction, rest, message):
    body = BitWriter().write(np.array(counts), 20).write(np.array(fraction, int), 16)
    with pytest.raises(ValueError, match=message):
        read_cones(BitReader(body.to_bytes() + rest), DOMAIN, 4)


def test_a_rank_beyond_the_sources_is_refused():
    body = bits_of(DOMAIN, StoredCones(SOURCES, np.zeros(1, int)))
    body._bits.pop()  # the ranks of one leaf
    while body.num_bits > bits_of(DOMAIN, StoredCones(SOURCES, np.zeros(1, int))).num_bits - 1:
        body._bits.pop()
    body.write(np.array([0]), 1).write(np.array([0]), 1).write(np.array([0]), 1).write_coded(np.array([0]))
    with pytest.raises(ValueError, match="names source 3 of 3"):
        read_cones(BitReader(body.to_bytes()), DOMAIN, 1)


@pytest.mark.parametrize(
    ("x", "distance", "message"),
    [(0.0, 1e39, "scale them down"), (1e19, 0.0, r"Cones take distances and domains within 1e\+18")],
)
def test_what_cannot_be_squared_in_32_bits_is_refused(x, distance, message):
    with pytest.raises(ValueError, match=message):
        store_sources(np.array([[x, 0.0]]), np.array([distance]), np.zeros(1, int), Box((0, 0), (8 + 2 * x, 8)))


@pytest.mark.parametrize("width", [1e6, 2.0**26, 1e9, 1e17])
def test_domains_of_any_width(width):
    points, parents = width * np.array([[0.25, 0.3], [0.5, 0.7], [0.9, 1.0]]), np.array([0, 0, 1])
    distances, domain = distances_along(points, parents, np.zeros(3)), Box([0, 0], [width, width])
    stored, index = store_sources(points, distances, parents, domain)
    cones = StoredCones(stored, index[[2, 0, 1, 1]])
    found = read_cones(BitReader(bits_of(domain, cones).to_bytes()), domain, 4)
    np.testing.assert_array_equal(found.source, cones.source)
    np.testing.assert_allclose(found.sources.points[index], points, atol=2.0**-25 * width)
    np.testing.assert_allclose(found.sources.offsets[index], distances, rtol=1e-6)
