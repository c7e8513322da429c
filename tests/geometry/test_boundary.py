import numpy as np
import shapely

from plr_jax.geometry.boundary import RingEdges
from plr_jax.geometry.vectors import left_normal


def test_the_boundary_of_a_ring_has_the_region_on_its_left():
    region = shapely.box(0, 0, 9, 9) - shapely.box(3, 3, 6, 6)
    boundary = RingEdges.of(region, 1e-9).boundary
    middle = boundary.segments.mean(axis=1)
    inward = left_normal(boundary.segments[:, 1] - boundary.segments[:, 0])
    assert shapely.contains_xy(region, *(middle + 0.1 * inward).T).all()
    np.testing.assert_array_equal(boundary.normal, inward)
    np.testing.assert_allclose((boundary.normal * boundary.segments[:, 1]).sum(axis=1), boundary.offset)
    reflex = boundary.vertices[boundary.edges[boundary.is_reflex(1e-9), 0]]
    assert sorted(map(tuple, reflex)) == [(3, 3), (3, 6), (6, 3), (6, 6)]
    assert len(boundary.contacts) == 0


def test_sectors_at_a_contact_are_those_between_the_obstacles():
    # Two blocks touch in (2, 2): free sectors open from (2, 3) to (1, 2) and from (2, 1) to (3, 2).
    region = shapely.box(0, 0, 4, 4) - shapely.union_all([shapely.box(1, 1, 2, 2), shapely.box(2, 2, 3, 3)])
    boundary = RingEdges.of(region, 1e-9).boundary
    (contact,) = boundary.contacts
    np.testing.assert_array_equal(boundary.vertices[contact], [2, 2])
    edges = np.flatnonzero(boundary.edges[:, 0] == contact)
    ends = boundary.vertices[np.stack([boundary.edges[edges, 1], boundary.sector_end[edges]], axis=1)]
    assert sorted(ends.tolist()) == [[[2, 1], [3, 2]], [[2, 3], [1, 2]]]
    offsets = np.array([[-1.0, 1.0], [0, 1], [-1, 0], [1, -1], [1, 1]])
    (upper_left,) = edges[ends[:, 0, 1] == 3]  # its walls included
    np.testing.assert_array_equal(boundary.in_sector(upper_left, offsets, 1e-9), [True, True, True, False, False])


def test_an_edge_is_split_where_a_vertex_lies_on_it():
    # The tip of a triangular hole touches the middle of the bottom.
    region = shapely.Polygon([[0, 0], [4, 0], [4, 4], [0, 4]], [[[2, 1e-12], [1, 2], [3, 2]]])
    boundary = RingEdges.of(region, 1e-9).boundary
    assert len(boundary.edges) == 4 + 3 + 1
    (contact,) = boundary.contacts
    np.testing.assert_allclose(boundary.vertices[contact], [2, 0], atol=1e-9)
