import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plr_jax.geometry.box import Box
from plr_jax.plr.file.bits import BitReader, BitWriter
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
    distances = np.zeros(count)
    for i in range(count):
        distances[i] = (
            rng.integers(9) / 8 if parents[i] == i else distances[parents[i]] + _length(points, i, parents[i])
        )
    return points, distances, parents


def _length(points, i, j):
    return np.sqrt(((points[i] - points[j]) ** 2).sum())


def bits_of(domain, cones):
    body = BitWriter()
    write_cones(body, domain, cones)
    return body


@pytest.mark.parametrize("lattice", LATTICES)
@given(st.integers(0, 100_000), st.integers(1, 5), st.sampled_from([1, 2, 17, 60]))
@settings(max_examples=12, deadline=None)
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
    ("lattice", "expected"), [("integers", 1), ("hundredths", 100), ("quarters", 4), ("thirds", 3)]
)
def test_the_lattice_of_a_map_is_found(lattice, expected):
    points, distances, parents = random_sources(np.random.default_rng(1), 2, 40, lattice)
    stored, _ = store_sources(points, distances, parents, Box(points.min(axis=0), points.max(axis=0) + 1))
    assert stored.fraction == expected
    np.testing.assert_allclose(stored.points, np.unique(points, axis=0), atol=1e-13)


def test_points_on_no_lattice_are_kept_to_a_fine_step():
    points, distances, parents = random_sources(np.random.default_rng(1), 2, 40, "none")
    stored, _ = store_sources(points, distances, parents, Box((-300, -300), (700, 700)))
    assert stored.num_fine == 40 and stored.exponent == -16
    assert len(bits_of(Box((-300, -300), (700, 700)), StoredCones(stored, np.zeros(1, int))).to_bytes()) < 40 * 8


def test_sources_at_one_place_are_stored_once():
    points = np.array([[0.0, 0], [1, 1], [1, 1 + 1e-15], [0, 0]])
    stored, index = store_sources(
        points, np.array([0, 2**0.5, 2**0.5, 0]), np.array([0, 0, 0, 3]), Box((0, 0), (2, 2))
    )
    assert index.tolist() == [0, 1, 1, 0]
    assert stored.parent.tolist() == [0, 0] and stored.is_root.tolist() == [True, False]
    np.testing.assert_allclose(stored.offsets, [0, 2**0.5])


def test_offsets_are_the_lengths_along_long_chains():
    """A spiral of a thousand turns, each after the one before, and the goal of 5 at its end."""
    count = 1000
    points = np.column_stack([np.arange(count), np.arange(count) % 2]).astype(float)
    parents = np.maximum(np.arange(count) - 1, 0)
    stored, index = store_sources(points, 5 + np.sqrt(2) * np.arange(count), parents, Box((0, 0), (1000, 1)))
    np.testing.assert_allclose(stored.offsets[index], 5 + np.sqrt(2) * np.arange(count))


def test_ranks_are_few_bits_where_leaves_take_turns():
    """Leaves that alternate between two sources take two bits each, those that stay one."""
    points = np.arange(200.0).reshape(100, 2)
    stored, _ = store_sources(points, np.zeros(100), np.arange(100), Box((0, 0), (200, 200)))
    one, two = (
        bits_of(Box((0, 0), (200, 200)), StoredCones(stored, s)).num_bits
        for s in (np.full(1000, 77), 77 + np.arange(1000) % 2)
    )
    assert two - one < 1100
    assert one < 100 * 60 + 1100


@given(st.binary(max_size=400), st.integers(1, 5), st.integers(1, 300))
@settings(max_examples=150, deadline=None)
def test_arbitrary_bits_are_read_or_refused(data, dim, num_leaves):
    try:
        found = read_cones(BitReader(data), Box(np.zeros(dim), np.ones(dim)), num_leaves)
    except ValueError:
        return
    assert found.source.shape == (num_leaves,) and (found.source < len(found.sources.code)).all()
    assert np.isfinite(found.sources.offsets).all() and np.isfinite(found.sources.points).all()


def stored_sources(**changes):
    """Three sources, each the parent of the next, as a file keeps them."""
    given = {
        "num_fine": 0,
        "exponent": 0,
        "fraction": 1,
        "code": np.array([[0, 0], [1, 4], [2, 7]]),
        "parent": np.array([0, 0, 1]),
        "root_offset": np.zeros(3),
    }
    return StoredSources(**{**given, **changes})


DOMAIN = Box((0, 0), (8, 8))


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
    domain = Box((0, 0), (8, 8))
    sources = stored_sources(**changes)
    body = bits_of(domain, StoredCones(sources, np.zeros(4, int)))
    with pytest.raises(ValueError, match=message):
        read_cones(BitReader(body.to_bytes()), domain, 4)


def test_no_sources_and_no_step_are_refused():
    body = BitWriter().write(np.array([0, 0]), 20)
    with pytest.raises(ValueError, match="no sources"):
        read_cones(BitReader(body.to_bytes() + b"\0" * 99), DOMAIN, 4)
    body = BitWriter().write(np.array([0, 1]), 20).write(np.array([0]), 16)
    with pytest.raises(ValueError, match="steps of 1 / 0"):
        read_cones(BitReader(body.to_bytes() + b"\0" * 99), DOMAIN, 4)


def test_a_rank_beyond_the_sources_is_refused():
    body = bits_of(DOMAIN, StoredCones(stored_sources(), np.zeros(1, int)))
    body._bits.pop()  # the ranks of one leaf
    while body.num_bits > bits_of(DOMAIN, StoredCones(stored_sources(), np.zeros(1, int))).num_bits - 1:
        body._bits.pop()
    body.write(np.array([0]), 1).write(np.array([0]), 1).write(np.array([0]), 1).write_coded(np.array([0]))
    with pytest.raises(ValueError, match="names source 3 of 3"):
        read_cones(BitReader(body.to_bytes()), DOMAIN, 1)


def test_more_sources_than_bits_are_refused_before_they_are_made():
    """A count of a million sources in a dozen bytes."""
    body = BitWriter().write(np.array([0, 2**20 - 1]), 20).write(np.array([1]), 16)
    with pytest.raises(ValueError, match="end too early"):
        read_cones(BitReader(body.to_bytes() + bytes(range(1, 30))), DOMAIN, 4)


def test_distances_too_large_for_floats_are_refused():
    with pytest.raises(ValueError, match="scale them down"):
        store_sources(np.array([[0.0, 0]]), np.array([1e39]), np.zeros(1, int), DOMAIN)


def test_what_cannot_be_squared_in_32_bits_is_refused():
    with pytest.raises(ValueError, match=r"Cones take distances and domains within 1e\+18"):
        store_sources(np.array([[1e19, 0.0]]), np.zeros(1), np.zeros(1, int), Box([0, 0], [2e19, 1]))


@pytest.mark.parametrize("width", [1e6, 2.0**26, 1e9, 1e17])
def test_domains_of_any_width(width):
    points = width * np.array([[0.25, 0.3], [0.5, 0.7], [0.9, 1.0]])
    parents, distances = np.array([0, 0, 1]), np.zeros(3)
    distances[1] = _length(points, 0, 1)
    distances[2] = distances[1] + _length(points, 1, 2)
    domain = Box([0, 0], [width, width])
    stored, index = store_sources(points, distances, parents, domain)
    cones = StoredCones(stored, index[[2, 0, 1, 1]])
    found = read_cones(BitReader(bits_of(domain, cones).to_bytes()), domain, 4)
    np.testing.assert_array_equal(found.source, cones.source)
    np.testing.assert_allclose(found.sources.points[index], points, atol=2.0**-25 * width)
    np.testing.assert_allclose(found.sources.offsets[index], distances, rtol=1e-6)
