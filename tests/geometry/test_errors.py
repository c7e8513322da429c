"""Messages for invalid boxes, polygons, workspaces, changes and masks."""

import numpy as np
import pytest
import shapely
from piece_helpers import TEN, box

from plr_jax.geometry.boundary import as_polygon, as_polygons
from plr_jax.geometry.box import Box, Slice
from plr_jax.geometry.workspace import Workspace

SQUARE, BOX, SPACE = box(0, 0, 1, 1), Box((0, 1), (2, 5)), Box((0, -1, 5), (4, 1, 7))
TURN = Box((0, -np.pi), (2, np.pi), periodic=(False, True))
BOW_TIE, POINT = [[1.0, 1], [2, 2], [2, 1], [1, 2]], shapely.Point(1, 1)
BLOCK, CORNER = Workspace(TEN, [box(3, 3, 7, 6)]), Workspace(TEN, [SQUARE])
EYE = np.eye(3) > 0


def with_holes(holes):
    return Workspace.from_polygons([{"outer": SQUARE, "holes": holes}])


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda: Box((0, 0), (1, 0)), "positive width along every axis.*axis 1"),
        (lambda: Box((0, 0), (1, 1, 1)), "equal length"),
        (lambda: Box((0, np.nan), (1, 1)), "Box lo must have finite coordinates"),
        (lambda: Box((0, 0), (np.inf, 1)), "Box hi must have finite coordinates"),
        (lambda: Box(0.0, 1.0), r"Box lo must be one point of shape \(dim,\), got shape \(\)"),
        (lambda: Box("a", "b"), "Box lo must be numbers"),
        (lambda: Box(*TEN, True), "Box periodic must be"),
        (lambda: Box(*TEN, (True,)), "Box periodic must be"),
        (lambda: Box(*TEN, (1, 0)), "Box periodic must be"),
        (lambda: Box.of(((0, 0),)), "The box must be a Box or its corners"),
        (lambda: BOX.contains(np.zeros((1, 3))), r"shape \(n, 2\), got \(1, 3\)"),
        (lambda: BOX.grid(0), "integer >= 1"),
        (lambda: SPACE.grid(4), "2 dimensions, got 3"),
        (lambda: TURN.wrapped(np.zeros((1, 3))), r"must have shape \(\.\.\., 2\), got \(1, 3\)"),
        (lambda: TURN.difference(np.ma.masked_less([[-1.0, 2.0]], 0), [0.0, 0]), "some are masked"),
        (lambda: TURN.image_near([0, 0], np.zeros((1, 3))), r"must have shape \(\.\.\., 2\), got \(1, 3\)"),
        (lambda: Slice.of(SPACE, None), "at must fix 1 of 3 coordinates, got 0"),
        (lambda: Slice.of(SPACE, {3: 1.0}), "at must map axes to coordinates"),
        (lambda: Slice.of(SPACE, {0: 9.0}), "at must lie in Box"),
        (lambda: Slice.of(SPACE, {0: float("nan")}), "must have finite coordinates"),
        (lambda: as_polygon("P", np.array(BOW_TIE)), "P is not a simple polygon.*Self-intersection.*make_valid"),
        (lambda: as_polygon("P", shapely.Polygon(SQUARE, [2 * SQUARE - SQUARE.mean(axis=0)])), "no area outside of"),
        (lambda: as_polygon("P", 1e155 * SQUARE), "P must have coordinates up to 1e\\+100"),
        (lambda: as_polygon("P", [[1.0, 1], [2, 2], [2, 2], [1, 1]]), "P has 2 distinct vertices"),
        (lambda: as_polygon("P", [[1.0, 1], [2, 2], [3, 3]]), "P has zero area"),
        (lambda: as_polygon("P", [[1.0, 1], [np.nan, 2], [2, 1]]), "P must have finite coordinates"),
        (lambda: as_polygon("P", shapely.LineString([[1, 1], [2, 2]])), "P must be a polygon, got a LineString"),
        (lambda: as_polygon("P", "ring"), "P must be numbers"),
        (lambda: as_polygons("P", 5), r"Ps must be a list of rings \(n, 2\) or Shapely polygons, got 5"),
        (lambda: as_polygons("P", shapely.GeometryCollection([POINT])), "P 0 must be a polygon, got a Point"),
        (lambda: as_polygons("P", SQUARE), r"P 0 must have shape \(n, 2\), got \(2,\). Put a single ring into"),
        (lambda: Workspace(TEN, [SQUARE, "ring"]), "Obstacle 1 must be numbers"),
        (lambda: Workspace(((0, 0), (1, 1e155))), "coordinates up to 1e"),
        (lambda: Workspace(((0, 0), (1e-160, 1e-160))), "longer side must be at least 1e-100, .* smaller unit"),
        (lambda: Workspace(((1e12, 0), (1e12 + 1, 1))), "10 times its tolerance, 1, .* the origin"),
        (lambda: Workspace(((0, 0, 0), (1, 1, 1))), "2 dimensions"),
        (lambda: Workspace(TEN, [box(-1, -1, 11, 11)]), "no free space"),
        (lambda: Workspace.from_polygons([]), "at least one component"),
        (lambda: Workspace.from_polygons([SQUARE]), "Component 0 must be a mapping.*or a Shapely polygon"),
        (lambda: Workspace.from_polygons([POINT]), "Component 0 must be a polygon, got a Point"),
        (lambda: Workspace.from_polygons([shapely.box(0, 0, 1, 1)], 3.0), "Bounds must be a Box"),
        (lambda: with_holes([box(0, 0, 0, 1)]), "Hole 0 of component 0 has 2 distinct"),
        (lambda: with_holes(None), "Component 0 must be a mapping with an 'outer' ring and a list of 'holes'"),
        (lambda: BLOCK.sample_free(-1, 0), "n must be an integer >= 0, got -1"),
        (lambda: BLOCK.inflate(-1.0), "at least 0"),
        (lambda: BLOCK.inflate(5.0), "leaves no free space"),
        (lambda: BLOCK.is_free(np.zeros(2)), r"\(n, 2\).*x\[None\]"),
        (lambda: BLOCK.clearance(np.zeros((4, 3))), r"\(n, 2\), got \(4, 3\)"),
        (lambda: BLOCK.is_visible(np.zeros((2, 2)), np.zeros((3, 2))), "as many starts as ends"),
        (lambda: BLOCK.is_visible([(1, 1)], [(2, 2)], -1), "tolerance must be a finite number of at least 0, got -1"),
        (lambda: CORNER.with_obstacles(remove=[3]), "remove must be numbers of obstacles, below 1"),
        (lambda: CORNER.with_obstacles(remove=[-1]), "integer >= 0"),
        (lambda: CORNER.with_obstacles(remove=[box(0, 0, 1, 2)]), "or polygons that equal one"),
        (lambda: CORNER.with_obstacles(remove=SQUARE), "Removed obstacle .* Put a single ring into a list"),
        (lambda: CORNER.with_obstacles(remove=[0]).with_obstacles(remove=[0]), "not removed already"),
        (lambda: CORNER.with_obstacles([[(0, 0), (1, 1)]]), "Added obstacle 0 has 2 distinct vertices"),
        (lambda: CORNER.with_obstacles([box(-1, -1, 11, 11)]), "no free space"),
        (lambda: Workspace.from_mask(1.0 * EYE), r"booleans of shape \(rows, columns\), such as .*, got float64"),
        (lambda: Workspace.from_mask(np.ma.masked_equal(EYE, True)), "some masked"),
        (lambda: Workspace.from_mask(np.zeros((3, 4), bool)), "No pixel of 3 x 4 is free"),
        (lambda: Workspace.from_mask(np.indices((700, 700)).sum(axis=0) % 2 == 0), "at most 262,144 corners"),
        (lambda: Workspace.from_mask(EYE, drop_specks=0.5), "drop_specks must be an integer"),
        (lambda: Workspace.from_mask(EYE, 0), "resolution must be a positive"),
        (lambda: Workspace.from_mask(EYE, 1e307), r"up to 1e\+100, got pixels of side .* choose a larger unit"),
        (lambda: Workspace.from_mask(EYE, origin=(1e300, 0)), "as far out as .* choose a larger unit"),
        (lambda: Workspace.from_mask(EYE, 1e-9, (1e6, 1e6)), "at least 8e-06 at .*, got 1e-09: choose an or"),
        (lambda: Workspace.from_mask(EYE, tolerance=-1), "tolerance must be"),
        (lambda: Workspace.from_mask(EYE, origin=(0, np.nan)), r"finite numbers \(x, y\) or \(x, y, yaw\)"),
        (lambda: Workspace.from_mask(EYE, row0="up"), "row0 must be 'bottom' or 'top', got 'up'"),
    ],
)
@pytest.mark.usefixtures("unchecked_types")
def test_invalid_arguments_raise(ask, message):
    with pytest.raises(ValueError, match=message):
        ask()
