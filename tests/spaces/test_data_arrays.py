"""Rasters as they come from files and from xarray, compared with what rasterio reads."""

import builtins
import struct
import zipfile
from itertools import product

import numpy as np
import pytest

from plr_jax import RasterCost, cost_distance
from plr_jax.rasters import _cost_distance
from plr_jax.spaces._data_arrays import data_array_box, is_in_degrees, opened, raster_values

xarray = pytest.importorskip("xarray")
rasterio, rioxarray = pytest.importorskip("rasterio"), pytest.importorskip("rioxarray")
shutil, Affine = pytest.importorskip("rasterio.shutil"), rasterio.Affine

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
    defaults = size | {"driver": "GTiff", "crs": "EPSG:32633"}
    is_internal = options.pop("internal", True)
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=is_internal), rasterio.open(path, "w", **defaults | options) as file:
        file.write(costs)
        if edit:
            edit(file)
    if overviews:
        with rasterio.open(path, "r+") as file:
            file.build_overviews([2])
    return path


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


TYPES = "uint8", "int16", "uint16", "int32", "float32", "float64"
COMPRESSIONS = "none", "lzw", "deflate", "packbits"
TILED = {"tiled": True, "blockxsize": 16, "blockysize": 16}
STORED = [
    {"dtype": dtype, "compress": compress, "ENDIANNESS": order, "BIGTIFF": "YES" if k % 3 == 0 else "NO"}
    | (TILED if compress == "lzw" else {})
    for (k, (dtype, compress)), order in product(enumerate(product(TYPES, COMPRESSIONS)), ("BIG", "LITTLE"))
]
FILES = STORED[::2]
NO_DATA = {
    "uint8": (0, 50),
    "int8": (-128,),
    "int16": (-32_768,),
    "uint16": (65_535,),
    "int32": (-(2**31),),
    "uint32": (2**32 - 1,),
    "float32": (-9999, 1e20, LOWEST, -LOWEST, 9.96921e36, 99_999.9, -3.4e38, np.nan, np.inf, -np.inf),
    "float64": (1e20, LOWEST, -np.finfo(float).max),
}
FILES += [{"dtype": dtype, "nodata": value, "holes": value} for dtype, values in NO_DATA.items() for value in values]
FILES += [{"transform": Affine(dx, 0, 3e5, 0, dy, 5e6)} for dx, dy in product((10, -10, 30, 2), (-10, 10, 2))]
FILES += [
    {"shape": shape, "transform": Affine(30, 0, 3e5, 0, dy, 5e6)}
    for shape, dy in product([(1, 9), (9, 1), (1, 1), (2, 1)], (-10, 10))
]
FILES += [
    {"holes": np.nan},
    {"holes": np.inf},
    {"holes": np.nan, "nodata": -9999},
    {"edit": write_mask, "internal": True},
    {"edit": write_mask, "internal": False},
    {"edit": write_mask, "dtype": "uint8", "nodata": 50, "holes": 50},  # the mask decides
    {"overviews": True} | TILED,
    {"compress": "lerc"},
    {"compress": "zstd", "predictor": 3},
    {"compress": "deflate", "predictor": 2, "dtype": "int16", "ENDIANNESS": "BIG"},
    {"dtype": "uint16", "nbits": 12},
    {"nbits": 16},
    {"dtype": "int64", "nodata": -1, "holes": -1},
    {"dtype": "uint8", "photometric": "palette"},
    {"SPARSE_OK": True, "crs": None},
    {"dtype": "int16", "nodata": -1, "holes": -1, "edit": setting(scales=(0.01,), offsets=(3,))},
    {"dtype": "uint8", "nodata": 0, "holes": 0, "edit": setting(scales=(0.5,), units=("minutes",))},
    {"dtype": "int32", "edit": setting(scales=(0.001,), units=("days since 1970-01-01",), descriptions=("cost",))},
    {"edit": lambda file: file.update_tags(AREA_OR_POINT="Point", missing_value=7, scale_factor=3, crs="mine")},
    {"driver": "COG", "compress": "deflate", "nodata": -9999, "holes": -9999},
    {"driver": "AAIGrid", "crs": None, "nodata": -9999, "holes": -9999},
    {"driver": "PNG", "dtype": "uint8", "WORLDFILE": "YES", "crs": None},
]


@pytest.mark.parametrize(
    "options",
    [*FILES, *(pytest.param(options, marks=pytest.mark.full) for options in STORED[1::2])],
    ids=lambda options: "-".join("edit" if callable(each) else str(each) for each in options.values()),
)
def test_files_are_read_as_by_rasterio(options, tmp_path):
    check(write(tmp_path / "costs", **options))


def test_negative_scale_is_read_as_by_rasterio(tmp_path):
    path = write(tmp_path / "costs.tif")
    scale = struct.pack("<3d", 10, 10, 0)  # of ModelPixelScale
    assert scale in path.read_bytes()
    path.write_bytes(path.read_bytes().replace(scale, struct.pack("<3d", 10, -10, 0)))
    check(path)


def test_virtual_rasters_and_archives_are_read(tmp_path):
    path = write(tmp_path / "costs.tif", nodata=-9999, holes=-9999)
    shutil.copy(path, tmp_path / "costs.vrt", driver="VRT")
    check(tmp_path / "costs.vrt")
    with zipfile.ZipFile(tmp_path / "costs.zip", "w") as archive:
        archive.write(path, "costs.tif")
    check(f"zip://{tmp_path}/costs.zip!costs.tif")


def test_chosen_band_has_alpha_as_mask(tmp_path):
    path = write(tmp_path / "costs.tif", dtype="uint8", count=2, holes=0, photometric="minisblack", alpha="yes")
    with rasterio.open(path, "r+") as file:
        file.write((np.arange(88, dtype=np.uint8) % 5).reshape(8, 11), 2)
    values = raster_values("costs", rioxarray.open_rasterio(path, mask_and_scale=True)[0])
    np.testing.assert_array_equal(np.isinf(values).ravel(), np.arange(88) % 5 == 0)


@pytest.mark.parametrize("attrs", [{"units": "degrees_north"}, {"standard_name": "latitude"}, {}])
def test_netcdf_files_are_read(attrs, tmp_path):
    pytest.importorskip("scipy")
    coords = {"lat": ("lat", [10.0, 11], attrs), "lon": [20.0, 21, 22]}
    raster = xarray.DataArray([[1, 2.5, np.nan], [4, 5, 6]], coords, ("lat", "lon"), "costs", {"units": "minutes"})
    encoding = {"dtype": "int16", "scale_factor": 0.5, "_FillValue": -1}
    raster.to_netcdf(tmp_path / "costs.nc", engine="scipy", encoding={"costs": encoding})
    options = {"engine": "scipy", "decode_timedelta": False}
    for read in (
        opened("costs", tmp_path / "costs.nc")[::-1],
        xarray.open_dataarray(tmp_path / "costs.nc", **options),
    ):
        np.testing.assert_array_equal(raster_values("costs", read), [[1, 2.5, np.inf], [4, 5, 6]])
        box, _ = data_array_box("costs", read)
        assert box.lo.tolist() == [19.5, 9.5] and box.hi.tolist() == [22.5, 11.5] and is_in_degrees(read)
    unscaled = xarray.open_dataarray(tmp_path / "costs.nc", **options, mask_and_scale=False)
    with pytest.raises(ValueError, match="scale_factor or add_offset of values to be scaled: open it with mask_and"):
        raster_values("costs", unscaled)


def ground_control_points(file):
    points = [(0, 0), (0, 11), (8, 0), (8, 11)]
    points = [rasterio.control.GroundControlPoint(y, x, 2.0 * x, -2.0 * y) for y, x in points]
    file.gcps = points, rasterio.crs.CRS.from_epsg(32633)


@pytest.mark.filterwarnings("ignore:Dataset has no geotransform")
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"count": 2}, "file of one band, got several: choose one, as by rioxarray.open_rasterio"),
        ({"transform": Affine.rotation(30)}, "values is rotated: straighten it, with rioxarray"),
        ({"transform": None, "edit": ground_control_points}, "values is placed by ground control points"),
        ({"holes": LOWEST}, r"got -3\.40282e\+38, which looks like no data: mask such cells, or name the value"),
        ({"dtype": "complex64"}, "dtype=complex64"),
    ],
)
def test_other_rasters_raise(options, message, tmp_path):
    path = write(tmp_path / "costs.tif", **options)
    with pytest.raises(ValueError, match=message):
        RasterCost(path)


def test_other_files_raise(tmp_path, monkeypatch):
    whole = write(tmp_path / "costs.tif", shape=(99, 99)).read_bytes()
    for content in (b"", b"no raster", whole[: len(whole) // 2]):
        (tmp_path / "bad.tif").write_bytes(content)
        with pytest.raises(ValueError, match=r"bad\.tif: costs must be a file that rioxarray reads \("):
            cost_distance(str(tmp_path / "bad.tif"), [(0, 0)])
    with pytest.raises(ValueError, match="values must be a file that rioxarray reads"):
        RasterCost(tmp_path)
    with pytest.raises(FileNotFoundError, match=r"heights must be a file .*none\.tif: No such file"):
        cost_distance(np.ones((2, 2)), [(0, 0)], heights=tmp_path / "none.tif")
    imported = builtins.__import__
    missing = {"rioxarray"}

    def without(name, *rest):
        if name in missing:
            raise ModuleNotFoundError(name)
        return imported(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ImportError, match=r"costs is a path, which needs rioxarray: pip install 'plr-jax\[gis\]'"):
        cost_distance(tmp_path / "costs.tif", [(0, 0)])


def raster_of(values, dims=("y", "x"), attrs=(), encoding=(), **coords):
    """Return a DataArray with cells of side 10 from north to south, or with the given coordinates."""
    values = np.atleast_2d(values)
    coords = {dims[0]: 10.0 * np.arange(values.shape[0])[::-1], dims[1]: 10.0 * np.arange(values.shape[1])} | coords
    raster = xarray.DataArray(values, coords, dims, attrs=dict(attrs))
    raster.encoding |= dict(encoding)
    return raster


KEYS = "_FillValue", "missing_value", "nodata", "nodatavals", "fill_value"
NUMBERS = 1e20, 9.96921e36, 3.4e38, -3.4e38, 99_999.9, 0.1
FORMS = float, str, lambda value: (value,), lambda value: [None, value], lambda value: np.array([value])
FORMS += (lambda value: str(value).encode(),)
CASES = [(np.float32, *case) for case in product(NUMBERS, (*FORMS, np.float32))]
CASES += [(np.float64, *case) for case in product((*NUMBERS, -1.7e308), FORMS)]


@pytest.mark.parametrize("key", ["_FillValue", "missing_value", "nodata", "nodatavals", "fill_value"])
def test_cells_without_data_are_blocked(key):
    for (dtype, value, form), table in product(CASES, ("attrs", "encoding")):
        raster = raster_of(np.array([1, value, 3], dtype), **{table: {key: form(value)}})
        np.testing.assert_array_equal(raster_values("costs", raster), [[1, np.inf, 3]])


def test_other_no_data_is_read():
    lost = [[1, np.inf, 3]]
    for raster in [
        raster_of(np.float32([1, 99_999.9, 3])).astype(float).assign_attrs(nodata=99_999.9),
        raster_of(np.float32([1, 2, 3])).rio.write_nodata(2),
        raster_of(np.float32([1, 2, 3])).rio.write_nodata(2, encoded=True),
        raster_of(np.float32([1, 2, 3])).rio.set_nodata(2),
        raster_of(np.uint8([1, 255, 3]), attrs={"_FillValue": np.uint8(255)}),
        raster_of(np.int64([1, -(2**63), 3]), attrs={"_FillValue": -(2**63)}),
        raster_of(np.float32([1, np.nan, 3]), encoding={"_FillValue": 1, "scale_factor": 0.1, "dtype": "int16"}),
        raster_of(np.float16([1, 2, 3]), attrs={"nodata": 2, "missing_value": 1e20}),
        raster_of(np.ma.masked_equal(np.float32([1, 2, 3]), 2)),
        np.ma.masked_equal(np.float32([[1, 2, 3]]), 2),
        raster_of([1.0, 2, 3], attrs={"nodata": 2, "nodatavals": (None,), "missing_value": "none", "fill_value": {}}),
    ]:
        np.testing.assert_array_equal(raster_values("costs", raster), lost)
    for values in (np.int32([100_000_000, 7]), np.ma.masked_array(np.float32([7, 2]), fill_value=1e20)):
        raster = raster_of(values, attrs={"nodata": 99_999_999})
        np.testing.assert_array_equal(raster_values("costs", raster), np.atleast_2d(values))


def test_values_are_copies_and_arrays_may_be_lazy():
    dask = pytest.importorskip("dask.array")
    values = np.ones((2, 2))
    for raster in (values, raster_of(values), np.broadcast_to(1.0, (2, 2)), dask.from_array(values)):
        raster_values("costs", raster)[0, 0] = 9
    assert (values == 1).all()
    lazy = raster_of(np.ones((4, 6))).chunk({"x": 2})
    np.testing.assert_array_equal(
        cost_distance(lazy, [(20, 10)]).distance, cost_distance(lazy.compute(), [(20, 10)]).distance
    )


def test_single_rows_have_cells_of_stated_shape():
    def sides(raster):
        box, _ = data_array_box("costs", raster)
        return (box.width / raster.shape[::-1]).tolist()

    long = Affine(10, 0, -5, 0, -30, 22)
    row = raster_of(np.ones((1, 3)))
    assert sides(row) == sides(row.T.rename(x="y", y="x")) == [10, 10]
    assert sides(row.rio.write_transform(long)) == [10, 30]
    assert sides(row[:, :1].rio.write_transform(long)) == [10, 30]
    assert sides(row.assign_coords(x=[0, 5, 10]).rio.write_transform(long)) == [5, 15]  # resampled
    assert sides(row[:, :1]) == [1, 1]


NAN = np.nan


@pytest.mark.parametrize(
    ("coords", "message"),
    [
        ({"x": [0, NAN, 2]}, "coordinates 'x' must be finite, got nan"),
        ({"y": [0, NAN]}, "coordinates 'y' must be finite, got nan"),
        ({"x": [0, 1, 3]}, "coordinates 'x' must be evenly spaced, got steps from 1 to 2"),
        ({"x": [1, 1, 1]}, "evenly spaced, got steps from 0 to 0"),
        ({"x": np.float32(5e6 + np.arange(3) * 0.1)}, "evenly spaced"),  # 32 bits cannot tell them apart
        ({"x": np.array(["2020-01-01", "2020-01-02", "2020-01-03"], "M8[ns]")}, "coordinates 'x' must be numbers"),
        ({"x": ["a", "b", "c"]}, "coordinates 'x' must be numbers"),
    ],
)
def test_other_coordinates_raise(coords, message):
    with pytest.raises(ValueError, match=message):
        data_array_box("costs", raster_of(np.ones((2, 3)), **coords))


def test_coordinates_of_all_numbers_are_read():
    for x, lo, step in [
        (np.uint8([2, 1, 0]), -0.5, -1),
        (np.float32(5e6 + np.arange(3)), 5e6 - 0.5, None),
        (np.float32([5e6 + 30.05, 5e6 + 60.05, 5e6 + 90.05]), 5e6 + 15, None),
        (np.int64([2**40, 2**40 + 2, 2**40 + 4]), 2**40 - 1, None),
    ]:
        box, flips = data_array_box("costs", raster_of(np.ones((2, 3)), x=x))
        assert box.lo[0] == lo and flips[1].step == step
    box, _ = data_array_box("costs", xarray.DataArray(np.ones((2, 3))))  # no coordinates: indices
    assert box.lo.tolist() == [-0.5, -0.5]


GEOGRAPHIC = [
    *({"crs": text} for text in ("EPSG:4326", "+init=epsg:4326", "+proj=longlat +datum=WGS84", "OGC:CRS84", 4326)),
    {"crs_wkt": 'BOUNDCRS[SOURCECRS[GEOGCRS["x"]]]'},
    {"crs_wkt": 'COMPD_CS["x",GEOGCS["y"]]'},
    *({key: rasterio.crs.CRS.from_epsg(4979).to_wkt()} for key in ("crs_wkt", "spatial_ref")),
    {"grid_mapping_name": "latitude_longitude"},
    {"grid_mapping_name": "rotated_latitude_longitude"},
]
PROJECTED = [
    *({"crs": text} for text in ("EPSG:32633", "+init=epsg:32633", "+proj=utm +zone=33", 3857)),
    {"crs_wkt": 'COMPD_CS["x",PROJCS["y",GEOGCS["z"]]]'},
    {"crs_wkt": 'BOUNDCRS[SOURCECRS[PROJCRS["x",BASEGEOGCRS["y"]]]]'},
    {"spatial_ref": rasterio.crs.CRS.from_epsg(2154).to_wkt()},
]


@pytest.mark.filterwarnings("ignore:It is recommended to use 'rio.write_crs")
def test_degrees_are_told_by_units_reference_systems_and_names():
    values = np.ones((2, 3))
    plane, named = raster_of(values), raster_of(values, dims=("Lat", "LONGITUDE"))
    assert not is_in_degrees(plane) and is_in_degrees(named)
    assert not is_in_degrees(plane.assign_attrs(crs="of a surveyor")) and is_in_degrees(named.assign_attrs(crs=None))
    for tables, expected in ((GEOGRAPHIC, True), (PROJECTED, False)):
        for table, raster in product(tables, (plane, named)):
            assert is_in_degrees(raster.assign_attrs(table)) is expected, table
            assert is_in_degrees(raster.assign_coords(spatial_ref=((), 0, table))) is expected, table
    for attrs in ({"units": "degrees_east"}, {"units": "Degree"}, {"standard_name": "longitude"}):
        assert is_in_degrees(plane.assign_coords(x=("x", [0, 1, 2], attrs)))
    assert is_in_degrees(plane.rio.write_crs(4326)) and not is_in_degrees(named.rio.write_crs(32633))
    assert is_in_degrees(plane.rio.set_crs(4326))
    for crs in ("EPSG:4807", "IAU_2015:30100", "+proj=longlat +R=3396190"):  # in grads; of the Moon and of Mars
        with pytest.raises(ValueError, match="Coordinates must be degrees on the Earth, got"):
            is_in_degrees(plane.assign_attrs(crs=crs))


def test_raster_costs_warn_of_degrees(tmp_path):
    path = write(tmp_path / "costs.tif", crs="EPSG:4326", transform=Affine(0.1, 0, 7, 0, -0.1, 50))
    with pytest.warns(UserWarning, match="seem to be degrees, so that lengths are in degrees: project the raster"):
        RasterCost(path)
