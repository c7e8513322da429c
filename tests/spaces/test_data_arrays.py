"""Rasters as they come from files and from xarray, compared with what rasterio reads."""

import builtins
import warnings
from itertools import product

import numpy as np
import pytest

from plr_jax import RasterCost, cost_distance
from plr_jax.rasters import _cost_distance
from plr_jax.spaces._data_arrays import data_array_box, is_in_degrees, opened, raster_values

xarray = pytest.importorskip("xarray")
rasterio, rioxarray = pytest.importorskip("rasterio"), pytest.importorskip("rioxarray")
Affine = rasterio.Affine

NORTH_UP = Affine(10, 0, 300_000, 0, -10, 5_000_200)
LOWEST = float(np.finfo(np.float32).min)


@pytest.fixture(autouse=True)
def _few_cells(monkeypatch):
    monkeypatch.setattr(_cost_distance, "_FINE_CELLS", 100)


def write(
    path, dtype="float32", transform=NORTH_UP, shape=(8, 11), holes=None, edit=None, overviews=False, **options
):
    """Write costs from 1 to 100, some of them replaced by ``holes``, as a GeoTIFF."""
    costs = np.random.default_rng(0).integers(1, 100, (options.get("count", 1), *shape)).astype(dtype)
    if holes is not None:
        costs.reshape(-1)[::7] = np.array(holes).astype(dtype)
    size = {"height": shape[0], "width": shape[1], "count": 1, "dtype": dtype, "transform": transform}
    with rasterio.open(path, "w", driver="GTiff", **size | {"crs": "EPSG:32633"} | options) as file:
        file.write(costs)
        if edit:
            edit(file)
    if overviews:
        with rasterio.open(path, "r+") as file:
            file.build_overviews([2])


def check(path):
    """Check values, barriers, cells and the cell of a source against rasterio."""
    with rasterio.open(path) as file:
        cells, transform, bounds = file.read(1, masked=True), file.transform, file.bounds
        expected = np.ma.filled(cells * float(file.scales[0]) + file.offsets[0], np.inf)
    raster = opened("costs", path)
    values = raster_values("costs", raster)
    np.testing.assert_allclose(values, np.where(np.isnan(expected), np.inf, expected), rtol=1e-6)
    box, flips = data_array_box("costs", raster)
    np.testing.assert_allclose([box.lo, box.hi], np.sort(np.reshape(bounds, (2, 2)), axis=0), rtol=1e-12)
    steps = [step if count > 1 else 1 for step, count in zip((transform.e, transform.a), values.shape, strict=True)]
    assert [flip.step for flip in flips] == [-1 if step < 0 else None for step in steps]
    row, column = np.argwhere(np.isfinite(values))[-1]
    source = transform @ (column + 0.5, row + 0.5)
    distance = cost_distance(raster, [source]).distance.values
    assert np.argmin(distance) == row * values.shape[1] + column
    assert np.isinf(distance[np.isinf(values)]).all()
    assert RasterCost(path, interpolation="nearest")([source])[0] == values[row, column]


def write_mask(file):
    file.write_mask(np.arange(88).reshape(8, 11) % 5 > 0)


def setting(**values):
    """Return a function that sets attributes of an open file."""
    return lambda file: [setattr(file, name, value) for name, value in values.items()]


TYPES, COMPRESSIONS = (
    ("uint8", "int16", "uint16", "int32", "float32", "float64"),
    ("none", "lzw", "deflate", "packbits"),
)
FILES = [
    {"dtype": dtype, "compress": compress, "ENDIANNESS": order, "tiled": compress == "lzw", "BIGTIFF": big}
    | ({"blockxsize": 16, "blockysize": 16} if compress == "lzw" else {})
    for (k, (dtype, compress)), order in product(enumerate(product(TYPES, COMPRESSIONS)), ("LITTLE", "BIG"))
    for big in ["YES" if k % 3 == 0 else "NO"]
]
FILES += [
    {"dtype": dtype, "nodata": value, "holes": value}
    for dtype, value in [
        *(("uint8", 0), ("uint8", 50), ("int8", -128), ("int16", -32_768), ("uint16", 65_535), ("int32", -(2**31))),
        *(("uint32", 2**32 - 1), ("float32", -9999), ("float32", 1e20), ("float32", LOWEST), ("float32", -LOWEST)),
        *(
            ("float32", 9.96921e36),
            ("float32", 99_999.9),
            ("float32", -3.4e38),
            ("float64", 1e20),
            ("float64", LOWEST),
        ),
        *(("float64", -np.finfo(float).max), *product(["float32"], [np.nan, np.inf, -np.inf])),
    ]
]
FILES += [{"transform": Affine(dx, 0, 3e5, 0, dy, 5e6)} for dx, dy in product((10, -10, 30, 0.1), (-10, 10, 0.1))]
FILES += [
    {"shape": shape, "transform": Affine(30, 0, 3e5, 0, dy, 5e6)}
    for shape, dy in product([(1, 9), (9, 1), (1, 1), (2, 1)], (-10, 10))
]
FILES += [
    {"holes": np.nan},
    {"holes": np.inf},
    {"holes": np.nan, "nodata": -9999},
    {"edit": write_mask},
    {"edit": write_mask, "dtype": "uint8", "nodata": 50, "holes": 50},  # the mask decides
    {"overviews": True, "tiled": True, "blockxsize": 16, "blockysize": 16},
    {"compress": "lerc"},
    {"compress": "zstd", "predictor": 3},
    {"compress": "deflate", "predictor": 2, "dtype": "int16", "ENDIANNESS": "BIG"},
    {"dtype": "uint16", "nbits": 12},
    {"SPARSE_OK": True, "crs": None},
    {"dtype": "int16", "nodata": -1, "holes": -1, "edit": setting(scales=(0.01,), offsets=(3,))},
    {"dtype": "uint8", "nodata": 0, "holes": 0, "edit": setting(scales=(0.5,), units=("minutes",))},
    {"dtype": "int32", "edit": setting(scales=(0.001,), units=("days since 1970-01-01",), descriptions=("cost",))},
    {"edit": lambda file: file.update_tags(AREA_OR_POINT="Point", missing_value=7, scale_factor=3, crs="mine")},
]


@pytest.mark.parametrize("options", FILES, ids=lambda options: "-".join(map(str, options.values())))
def test_files_are_read_as_by_rasterio(options, tmp_path):
    write(tmp_path / "costs.tif", **options)
    check(tmp_path / "costs.tif")
