"""PLRs of whole buildings that are queried in NumPy, without JAX, and exported as C."""

from dataclasses import dataclass
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from jaxtyping import Float

from plr_jax._files import StrPath, file_path
from plr_jax._types import ArrayLike
from plr_jax.buildings.floors import Floors, OnFloors
from plr_jax.geometry.box import Box
from plr_jax.plr.container import BUILDING_MAGIC, read_bytes
from plr_jax.plr.frame import is_far
from plr_jax.plr.portable.numpy import NumpyPLR
from plr_jax.plr.portable.writers import require_identifier, wrap_entries

_TEMPLATE = Path(__file__).with_name("building.h")  # with marks such as "${NAME}"


@dataclass(frozen=True, eq=False)
class NumpyBuildingPLR(OnFloors):
    """Distance to the nearest of a building's goals, over floors and links, without JAX: ``f(floor, x)``.

    :func:`load_numpy` or :meth:`BuildingPLR.numpy` makes it. ``plane`` is a :class:`NumpyPLR`.
    """

    def __call__(self, floor: ArrayLike, x: ArrayLike) -> Any:
        """Return the distance ``(...)`` at points ``x`` ``(..., 2)`` of floors, an index or an array ``(...)``.

        The distance includes the costs of links and the goal's offset. It is ``inf`` outside the floor's bounds and
        where the PLR of the plane answers ``inf``, NaN where a coordinate is NaN. ``ValueError`` for points of
        another shape or an unknown floor; inside ``jit``, an unknown floor gives NaN.
        """
        return self.plane(self.floors.in_plane(floor, x))

    def bounds(self, floor: ArrayLike, x: ArrayLike) -> tuple[Any, Any]:
        """Return proven lower and upper bounds ``(...)`` at points of free space; see :meth:`PLR.bounds`."""
        return self.plane.bounds(self.floors.in_plane(floor, x))

    def which(self, floor: ArrayLike, x: ArrayLike) -> Any:
        """Return the index ``(n,)`` of the link that paths take first: -1 if they take none, -2 without a path.

        If there are several goals, -1 does not tell which goal is nearest: build a PLR of each goal, and compare
        their distances. If paths by two links are about equally long, either link may be the answer. The leaves must
        be cones, else ``ValueError``.
        """
        return self.floors.next_links(self.plane.which(self.floors.in_plane(floor, x)))

    @property
    def max_error(self) -> float | None:
        """Proven upper bound of the error; None without a proof."""
        return self.plane.max_error

    def c_header(self, name: str, compact: bool = False) -> str:
        """Return a C99 header with ``float NAME_distance(int floor, const float x[2])``; see :meth:`PLR.c_header`.

        Coordinates are doubles if a floor is far from the origin. Results equal those of a call, bit for bit.
        An unknown floor gives NAN.
        """
        require_identifier(name)
        floors, count = self.floors, len(self.floors.lo)
        far = any(is_far(Box(*bounds)) for bounds in zip(floors.lo, floors.hi, strict=True))

        def entries(rows: Float[np.ndarray, "floors 2"]) -> str:
            suffix = "f" if rows.dtype == np.float32 else ""
            return "\n".join(wrap_entries(f"{{{x}{suffix}, {y}{suffix}}}" for x, y in rows.astype(str)))

        lo, hi, shift = map(entries, (floors.lo.astype(np.float32), floors.hi.astype(np.float32), floors.shift))
        plane, of_type = self.plane.c_header(f"{name}_plane", compact), "double" if far else "float"
        marks = {"NAME": name, "PLANE": plane, "TYPE": of_type, "COUNT": count, "LAST": count - 1}
        return Template(_TEMPLATE.read_text(encoding="utf-8")).substitute(marks, LO=lo, HI=hi, SHIFT=shift)


def load_numpy(path: StrPath) -> NumpyPLR | NumpyBuildingPLR:
    """Read a PLR, of a building or not, that :func:`save` wrote, without importing JAX.

    ``OSError`` if the file cannot be read. ``ValueError`` if this release cannot read the file as a PLR to fixed
    goals. Files with distances between any two points or places need JAX to be read: ``load(path).numpy()``.
    """
    path = file_path(path)
    try:
        data = read_bytes(path)
        if not data.startswith(BUILDING_MAGIC):
            return NumpyPLR(data)
        floors, rest = Floors.read(data)
        return NumpyBuildingPLR.of_parts(floors, NumpyPLR(rest))
    except ValueError as error:
        raise ValueError(f"{path} cannot be read as a PLR: {error}.") from error
