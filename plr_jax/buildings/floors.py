"""The floors of a building as parts of one plane, and the links between floors. Needs only NumPy."""

import json
import zlib
from dataclasses import astuple, dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any, Self, TypeAlias

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import as_bool, as_finite, as_finite_point, as_queries, require_integer, set_fields, shortened
from plr_jax._types import ArrayLike, Sources
from plr_jax.geometry.box import Box
from plr_jax.plr.container import BUILDING_MAGIC

Place: TypeAlias = tuple[int, tuple[float, float]]  # a floor, and a point (x, y) on it
PlaceLike: TypeAlias = Any  # a pair, such as (0, (1.5, 2)), that is checked and becomes a Place
Corners: TypeAlias = Float[np.ndarray, "floors 2"]
_MOST_BYTES = 2**24  # most bytes of the JSON text of floors and links that a reader unpacks
_MOST_GOALS = 2**20  # in a file
NO_PATH = -2  # takes the place of a link's index at points without a path
# Floors are shifted by multiples of 1, or of the next power of two below a share of the largest floor: the first one
# in small buildings, the second one in large buildings, where rounding to 32 bits would join floors.
_UNIT_SHARES = 2.0 ** np.array([-4.0, -13.0])


def as_place(name: str, value: Any) -> Place:
    """Check a pair of a floor's index and a finite point ``(x, y)``; ``name`` begins the message of an error."""
    if not (isinstance(value, tuple | list) and len(value) == 2):
        raise ValueError(f"{name} must be a pair (floor, (x, y)), got {shortened(value)}.")
    of = f"of {name[0].lower()}{name[1:]}"
    require_integer(f"The floor {of}", value[0], 0)
    x, y = as_finite_point(f"The point {of}", value[1], 2).tolist()
    return int(value[0]), (x, y)


@dataclass(frozen=True)
class Link:
    """A way between two points of a building that has its own cost: stairs, a lift, a one-way door, a teleporter.

    Args:
        start: The floor, an index, and the point ``(x, y)`` where the link starts.
        end: The floor and the point where it ends; the floor may be the same.
        cost: Cost of taking the link, in the units of the floors, finite and at least 0.
        both_ways: Whether the link can be taken from its end to its start, too, at the same cost.

    Raises:
        ValueError: If an argument is invalid.
    """

    start: PlaceLike
    end: PlaceLike
    cost: float | int
    both_ways: bool = True

    def __post_init__(self) -> None:
        name = f"the link from {shortened(self.start)} to {shortened(self.end)}"
        start, end = as_place(f"The start of {name}", self.start), as_place(f"The end of {name}", self.end)
        cost, both_ways = as_finite(f"The cost of {name}", self.cost), as_bool(f"both_ways of {name}", self.both_ways)
        set_fields(self, start=start, end=end, cost=cost, both_ways=both_ways)


@dataclass(frozen=True, eq=False)
class Route:
    """A path through a building.

    Attributes:
        legs: Pairs ``(floor, points)``: a path on one floor, ``(m, 2)``. The legs before and after a link end and
            start at the link's ends. Without a path there is no leg.
        links: Indices of the links between the legs, in order.
        length: Length of all legs plus the costs of links, in the units of the floors; ``inf`` without a path. The
            goal's offset is not included.
    """

    legs: list[tuple[int, Float[np.ndarray, "_ 2"]]]
    links: list[int]
    length: float


@dataclass(frozen=True, eq=False)
class Floors:
    """The floors of a building, side by side in one plane, and the links between them.

    Point ``x`` of floor ``k`` is the point ``x + shift[k]`` of the plane. All floors lie in ``domain``, a grid of
    equal cells, one floor in each cell. Shifts are multiples of a unit, a power of two, so that few coordinates are
    rounded when they are shifted. Floors are at least a unit apart.
    """

    lo: Corners  # of the floors' bounds
    hi: Corners
    links: tuple[Link, ...]
    num_goals: int = 0
    shift: Corners = field(init=False)
    domain: Box = field(init=False)

    def __post_init__(self) -> None:
        # 1. Cells of the grid, two units larger than the largest floor; 2**a columns and 2**b rows, so that cells of
        #    a partition do not reach into two floors once they are small.
        size = (self.hi - self.lo).max(axis=0)
        most, least = 2.0 ** np.floor(np.log2(_UNIT_SHARES * size.max()))
        unit = max(least, min(1.0, most))
        cell = (np.ceil(size / unit) + 2) * unit
        bits = (len(self.lo) - 1).bit_length()
        shapes = [(1 << a, 1 << bits - a) for a in range(bits + 1)]
        columns, rows = min(shapes, key=lambda shape: (cell * shape).max())
        # 2. Floors fill the grid row by row.
        row, column = np.divmod(np.arange(len(self.lo)), columns)
        corner = np.stack([column, row], axis=1) * cell
        domain = Box((0.0, 0.0), cell * (columns, rows))
        set_fields(self, shift=corner + unit - np.floor(self.lo / unit) * unit, domain=domain)

    @cached_property
    def arcs(self) -> list[tuple[int, Link]]:
        """Pairs of a link's index and the link in one direction: a link that leads both ways has two arcs."""
        arcs = []
        for i, link in enumerate(self.links):
            arcs.append((i, link))
            arcs += [(i, replace(link, start=link.end, end=link.start))] * link.both_ways
        return arcs

    def in_plane(self, floor: ArrayLike, x: ArrayLike) -> Any:
        """Return points ``x`` ``(..., 2)`` of floors ``(...)`` as points of the plane, NumPy or JAX as given.

        NumPy's points come back with 64 bits, exact up to their rounding. Points outside their floor's bounds become
        ``inf``. ``ValueError`` if ``floor`` is no integer array, or a NumPy array with an index of no floor; inside
        ``jit`` such points become NaN.
        """
        floor = floor if hasattr(floor, "__array_namespace__") else np.asarray(floor)
        x = x if hasattr(x, "__array_namespace__") else as_queries(x)
        module = next((a.__array_namespace__() for a in (x, floor) if not isinstance(a, np.ndarray)), np)
        count = len(self.lo)
        if floor.dtype.kind not in "iu":
            raise ValueError(f"floor must be an integer or an array of integers, got {shortened(floor)}.")
        if module is np:
            x = as_queries(x, 2)
            if ((floor < 0) | (floor >= count)).any():
                raise ValueError(f"floor must be at least 0 and less than {count}, got {shortened(floor)}.")
        elif x.ndim == 0 or x.shape[-1] != 2:
            raise ValueError(f"Points must have shape (..., 2), got {x.shape}.")
        try:
            np.broadcast_shapes(floor.shape, x.shape[:-1])
        except ValueError:
            expected = f"an index, or indices of shape {x.shape[:-1]} as the points"
            raise ValueError(f"floor must be {expected}, got shape {floor.shape}.") from None
        # Compare in 32 bits: rounding keeps the order, so that no point of a floor is outside by rounding.
        with np.errstate(over="ignore"):  # points far outside
            lo, hi = (module.asarray(corner.astype(np.float32))[floor] for corner in (self.lo, self.hi))
            rounded = x.astype(np.float32)
        inside = ((rounded >= lo) & (rounded <= hi)).all(axis=-1)
        if module is np:
            p = x.astype(np.float64) + self.shift[floor]
        else:
            x = x if x.dtype.kind == "f" else x.astype(np.float32)
            first = self.shift.astype(np.float32)
            p = x + module.asarray(first)[floor]
            if (rest := self.shift - first).any():  # floors far from the origin: the sum so far is exact
                p = p + module.asarray(rest.astype(np.float32))[floor]
            p = module.where(((floor >= 0) & (floor < count))[..., None], p, np.nan)
        return module.where(inside[..., None] | module.isnan(p), p, np.inf)

    def places_in_plane(self, places: Any) -> Any:
        """Return a pair of floors ``(...)`` and points ``(..., 2)`` as points of the plane, else ``ValueError``."""
        # Two plain points are a pair, too, but the first one has as many axes as the second one.
        if not isinstance(places, tuple | list) or len(places) != 2 or np.ndim(places[0]) >= np.ndim(places[1]):
            raise ValueError(
                f"Places must be (floor, points), of shapes (...) and (..., 2), got {shortened(places)}."
            )
        return self.in_plane(*places)

    def next_links(self, numbers: Any) -> Any:
        """Return the index of the link that a path takes next, given the number of the root where its leg ends.

        A root is a goal, numbered from 0, or the start of an arc (a link in one direction), numbered after the goals
        as in :attr:`arcs`. The index is -1 at a goal, and ``NO_PATH`` for the number -1.
        """
        links = np.array([-1] * self.num_goals + [link for link, _ in self.arcs] + [NO_PATH])
        return numbers.__array_namespace__().asarray(links)[numbers]

    def route(self, floor: int, start: Float[np.ndarray, "2"], source: int, sources: Sources) -> Route:
        """Return the route to a goal from ``start``, a point of the plane on a floor, given the path's first source.

        A source is a goal, or a corner where paths turn. ``source`` is its index in ``sources``, or -1 for no path.
        """
        numbers, exits = np.asarray(sources.root_numbers), np.asarray(sources.exits)
        legs, links, length, path = [], [], 0.0, [start]
        for _ in range(len(numbers)):  # sources of a damaged file may form a circle
            if source < 0:
                break
            path.append(sources.points[source])
            if numbers[source] < 0:
                source = int(sources.parents[source])
                continue
            # The source is a root: the leg ends at a goal, or where a link starts.
            leg = np.stack(path)
            leg = leg[np.append(True, (leg[1:] != leg[:-1]).any(axis=1))]
            legs.append((floor, leg - self.shift[floor]))
            length += float(np.linalg.norm(np.diff(leg, axis=0), axis=1).sum())
            if numbers[source] < self.num_goals:
                return Route(legs, links, length)
            index, link = self.arcs[numbers[source] - self.num_goals]
            links.append(index)
            length += link.cost
            source, (floor, end) = int(exits[source]), link.end
            path = [end + self.shift[floor]]
        return Route([], [], np.inf)

    @cached_property
    def text(self) -> str:
        """The floors and links as JSON."""
        links = [astuple(link) for link in self.links]
        content = {"lo": self.lo.tolist(), "hi": self.hi.tolist(), "links": links, "goals": self.num_goals}
        return json.dumps(content, separators=(",", ":"))

    @staticmethod
    @lru_cache(maxsize=64)
    def of_text(text: str) -> "Floors":
        """Decode the JSON of :attr:`text`; ``ValueError`` if it is invalid."""
        try:
            content = json.loads(text)
            lo, hi = (np.array(content[name], np.float64) for name in ("lo", "hi"))
            links, num_goals = tuple(Link(*link) for link in content["links"]), content["goals"]
            require_integer("goals", num_goals, 0)
            dims = {Box(*corners).dim for corners in zip(lo, hi, strict=True)}
            ends = [place[0] for link in links for place in (link.start, link.end)]
            if dims != {2} or max(ends, default=0) >= len(lo) or num_goals > _MOST_GOALS:
                raise ValueError("a floor is no box in the plane, a link leads to no floor, or goals are too many")
            with np.errstate(all="ignore"):  # floors of no possible size
                return Floors(lo, hi, links, num_goals)
        except (TypeError, KeyError, ValueError, RecursionError) as error:
            raise ValueError(f"its floors and links are invalid: {error}") from None

    def to_bytes(self) -> bytes:
        """Encode the floors for a file: a mark, the size of the compressed :attr:`text` in 4 bytes, and this text."""
        data = zlib.compress(self.text.encode(), 9)
        return BUILDING_MAGIC + len(data).to_bytes(4, "little") + data

    @staticmethod
    def read(data: bytes) -> "tuple[Floors, bytes]":
        """Decode the floors at the beginning of the file of a building; also return the rest of the file."""
        start = len(BUILDING_MAGIC) + 4
        end = start + int.from_bytes(data[len(BUILDING_MAGIC) : start], "little")
        try:  # text longer than the limit is cut off, and then is no JSON
            text = zlib.decompressobj().decompress(data[start:end], _MOST_BYTES).decode()
        except (zlib.error, UnicodeDecodeError) as error:
            raise ValueError(f"its floors and links are damaged: {error}") from None
        return Floors.of_text(text), data[end:]


@dataclass(frozen=True, eq=False)
class OnFloors:
    """A base class of functions of places, pairs ``(floor, x)``, that answer in the plane of all floors.

    Attributes:
        floors: Bounds of the floors, the links, and ``shift``, which moves each floor to its part of the plane.
        plane: The function in the plane: point ``x`` of floor ``k`` is ``x + floors.shift[k]`` there.
    """

    floors: Floors = field(repr=False)
    plane: Any

    @property
    def num_bytes(self) -> int:
        """Size of the file in bytes."""
        return len(self.to_bytes())

    def to_bytes(self) -> bytes:
        """Return the bytes of the file: the floors and links, then the file of ``plane``."""
        return self.floors.to_bytes() + self.plane.to_bytes()

    @classmethod
    def of_parts(cls, floors: Floors, plane: Any) -> Self:
        """Make an object from the two parts of a building's file: floors, and a function in the plane of all floors.

        ``ValueError`` if ``plane.domain`` differs from ``floors.domain``.
        """
        ours, given = ((box.lo, box.hi) for box in (floors.domain, plane.domain))
        if not np.array_equal(ours, given):
            raise ValueError("its floors do not lie in its domain")
        return cls(floors, plane)

    # JAX needs both functions for the subclasses that are pytrees.
    def tree_flatten(self) -> tuple[tuple[Any], str]:
        return (self.plane,), self.floors.text

    @classmethod
    def tree_unflatten(cls, text: str, children: tuple[Any]) -> "OnFloors":
        return cls(Floors.of_text(text), *children)
