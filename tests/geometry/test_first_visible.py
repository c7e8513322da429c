import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from plr_jax.geometry.first_visible import first_visible

LENGTHS = st.sampled_from([np.nan, np.inf, *np.arange(20.0)])


@st.composite
def searches(draw):
    """Lengths of the ways from some points, and which of them are visible."""
    shape = draw(st.tuples(st.integers(0, 6), st.integers(0, 50)))
    return draw(arrays(float, shape, elements=LENGTHS)), draw(arrays(bool, shape))


@given(searches())
def test_it_finds_what_testing_every_pair_finds(search):
    lengths, visible = search
    before = lengths.copy()
    way, shortest = first_visible(lengths, lambda point, way: visible[point, way])
    for row, seen, found, length in zip(lengths, visible, way, shortest, strict=True):
        seen &= ~np.isnan(row)
        if not seen.any():
            assert (found, length) == (-1, np.inf)
            continue
        assert seen[found]
        assert length == row[found] == row[seen].min()
    np.testing.assert_array_equal(lengths, before)


def test_the_shortest_are_tested_first_and_none_twice():
    tested = []

    def sees(point, way):
        tested.append(sorted(way.tolist()))
        return way == 12

    way, shortest = first_visible(np.arange(100.0)[None], sees)
    assert (way[0], shortest[0]) == (12, 12.0)
    assert tested == [[0, 1], [*range(2, 10)], [*range(10, 42)]]


def test_what_is_no_way_is_not_tested():
    def sees(point, way):
        np.testing.assert_array_equal(np.stack([point, way]), [[0, 1], [1, 0]])
        return np.array([True, False])

    way, shortest = first_visible(np.array([[np.nan, np.inf], [3.0, np.nan], [np.nan, np.nan]]), sees)
    np.testing.assert_array_equal(way, [1, -1, -1])
    np.testing.assert_array_equal(shortest, [np.inf, np.inf, np.inf])
