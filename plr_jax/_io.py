"""The public functions :func:`save` and :func:`load` for files of PLRs and of distances between any two points."""

from typing import Any

from plr_jax._arrays import shortened
from plr_jax._files import StrPath, file_path, write_atomically
from plr_jax.buildings.building_plr import BuildingPLR
from plr_jax.buildings.floors import Floors
from plr_jax.pairs.building_pairs import BuildingPairs
from plr_jax.pairs.grid_pairs import GridPairs
from plr_jax.pairs.pair_plr import PairPLR, pairs_from_bytes
from plr_jax.plr._plr import PLR, from_bytes
from plr_jax.plr.container import BUILDING_MAGIC, GRID_MAGIC, holds_pairs, read_bytes


def save(plr: PLR | BuildingPLR | PairPLR | BuildingPairs | GridPairs, path: StrPath) -> None:
    """Write a PLR, a BuildingPLR, a PairPLR, BuildingPairs or GridPairs to a file, completely or not at all.

    The file has ``plr.num_bytes`` bytes. To save a ``MetricPairs``, pass its attribute ``plr``. The files
    ``plr/portable/FORMAT.md`` and ``pairs/FORMAT.md`` document the formats. ``ValueError`` is raised for an object of
    another type and for an invalid ``path``, ``OSError`` if the file cannot be written.
    """
    if not isinstance(plr, PLR | BuildingPLR | PairPLR | BuildingPairs | GridPairs):
        kinds = "a PLR, a BuildingPLR, a PairPLR, BuildingPairs or GridPairs"
        raise ValueError(f"Only {kinds} can be saved, got {shortened(plr)}.")
    write_atomically(file_path(path), plr.to_bytes())


def load(path: StrPath) -> Any:
    """Read a PLR, a BuildingPLR, a PairPLR, BuildingPairs or GridPairs that :func:`save` wrote.

    The loaded object gives the same answers as the saved object, bit for bit.

    The first query of a PairPLR builds large lookup tables, which takes long if the map has thousands of corners.
    ``ValueError`` is raised if the file is truncated, corrupt, or of another kind or format version, ``OSError`` if
    the file cannot be read.
    """
    path = file_path(path)
    try:
        data = read_bytes(path)
        if data.startswith(BUILDING_MAGIC):
            floors, rest = Floors.read(data)
            if holds_pairs(rest):
                return BuildingPairs.of_parts(floors, pairs_from_bytes(rest))
            return BuildingPLR.of_parts(floors, from_bytes(rest))
        if data.startswith(GRID_MAGIC):
            return GridPairs.from_bytes(data)
        return pairs_from_bytes(data) if holds_pairs(data) else from_bytes(data)
    except ValueError as error:
        raise ValueError(f"{path} cannot be read as a PLR or as pairs: {error}.") from error
