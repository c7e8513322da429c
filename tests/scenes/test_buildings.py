"""Files of buildings."""

import json

import numpy as np
import pytest
import shapely
from building_scenes import GOAL, samples, two_floors

from plr_jax.scenes import is_building, read_building, save_building

BUILDING = two_floors()


def test_buildings_are_read_as_written(tmp_path):
    save_building(BUILDING, path := tmp_path / "home.json")
    assert is_building(path) and not is_building(tmp_path / "none.json")
    read, places = read_building(path), samples(BUILDING, 50)
    assert read.links == BUILDING.links
    np.testing.assert_array_equal(read.oracle(*GOAL)(*places), BUILDING.oracle(*GOAL)(*places))


def test_floors_may_be_files_beside_the_building(tmp_path):
    (tmp_path / "ground.wkt").write_text(shapely.to_wkt(BUILDING.floors[0].free_space, rounding_precision=-1))
    save_building(BUILDING, path := tmp_path / "home.json")
    content = json.loads(path.read_text())
    content["floors"][0] = "ground.wkt"
    path.write_text(json.dumps(content))
    floor, x = samples(BUILDING, 50)
    expected = BUILDING.oracle(*GOAL)(floor, x)
    np.testing.assert_allclose(read_building(path).oracle(*GOAL)(floor, x), expected, rtol=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": "plr_jax scene"}, "expected a building file"),
        ({"version": 2}, "this release reads up to 1"),
        ({"floors": 3}, "expected lists"),
        ({"floors": []}, "needs one or more floors"),
        ({"floors": [{"bounds": 1}]}, "floor 0: expected"),
        ({"links": [{"start": [0, [1, 1]]}]}, "expected links with start, end, cost"),
        ({"links": [{"start": [0, [1, 1]], "end": [1, [1, 1, 1]], "cost": 1}]}, "the end of the link from"),
        ({"links": [{"start": [0, [1, 1]], "end": [1, [1, 4]], "cost": -1}]}, "The cost of the link from"),
        ({"links": [{"start": [0, [1, 1]], "end": [2, [1, 4]], "cost": 1}]}, "The end of link 0 must be on a floor"),
        ({"links": [{"start": [0, [8.1, 1]], "end": [1, [1, 4]], "cost": 1}]}, "The start of link 0 must be in free"),
    ],
)
def test_invalid_buildings_are_refused(change, message, tmp_path):
    save_building(BUILDING, path := tmp_path / "home.json")
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(ValueError, match=rf"home.json: .*{message}"):
        read_building(path)
