"""Exact distances in buildings: floors that links join, such as stairs, lifts and one-way doors."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import shapely
from jaxtyping import Int

from plr_jax import _arrays
from plr_jax._arrays import as_offsets, require_type, shortened
from plr_jax._types import ArrayLike, Distances
from plr_jax.buildings.floors import Floors, Link, Place, Route, as_place
from plr_jax.geometry.corners import CornerVisibility, with_places
from plr_jax.geometry.graph import Arcs, path_ends
from plr_jax.geometry.workspace import Workspace, require_workspace
from plr_jax.oracles._several_goals import NearestGoal
from plr_jax.oracles._visibility_graph import NearestPaths, VisibilityGraph

if TYPE_CHECKING:
    from plr_jax.buildings.building_plr import BuildingPLR


@dataclass(frozen=True, eq=False, init=False)
class Building(_arrays.PickledWithoutCaches):
    """Floors, and the links between them, such as stairs, lifts, escalators, one-way doors and teleporters.

        building = plr_jax.Building([ground, first], [plr_jax.Link((0, (2, 3)), (1, (2, 4)), cost=9)])
        oracle = building.oracle(1, (8, 1))  # exact distances to a goal on floor 1
        oracle(0, x)  # (n,), from points x (n, 2) of floor 0

    Args:
        floors: A ``Workspace`` for each floor, all with one ``squeeze``. Their coordinates need not match.
        links: ``Link``s, whose ends lie in free space.

    Raises:
        ValueError: If an argument is invalid. The message names the link.
    """

    floors: tuple[Workspace, ...] = field(repr=False)
    links: tuple[Link, ...] = field(repr=False)

    def __init__(self, floors: Iterable[Workspace], links: Iterable[Link] = ()):
        for name, value in (("floors", floors), ("links", links)):
            require_type(name, value, Iterable, "a list")
        all_floors, all_links = tuple(floors), tuple(links)
        for floor in all_floors:
            require_workspace(floor)
        if len({floor.squeeze for floor in all_floors}) != 1:
            raise ValueError(f"A building needs one or more floors with equal squeeze, got {shortened(all_floors)}.")
        _arrays.set_fields(self, floors=all_floors, links=all_links)
        for i, link in enumerate(all_links):
            if not isinstance(link, Link):
                raise ValueError(f"links must be plr_jax.Link(start, end, cost), got {shortened(link)} at {i}.")
            self._require_free(f"The start of link {i}", link.start)
            self._require_free(f"The end of link {i}", link.end)

    def __repr__(self) -> str:
        return f"Building({len(self.floors)} floors, {len(self.links)} links)"

    def _require_free(self, name: str, place: Place) -> None:
        floor, point = place
        if floor >= len(self.floors):
            raise ValueError(f"{name} must be on a floor from 0 to {len(self.floors) - 1}, got floor {floor}.")
        if not self.floors[floor].is_free_to_tolerance(np.array([point]))[0]:
            raise ValueError(f"{name} must be in free space, got {point} on floor {floor}: move it.")

    @cached_property
    def plane_floors(self) -> Floors:
        """The floors, side by side in one plane, and the links."""
        lo, hi = (np.stack([getattr(floor.bounds, name) for floor in self.floors]) for name in ("lo", "hi"))
        return Floors(lo, hi, self.links)

    @cached_property
    def plane(self) -> Workspace:
        """The workspace of all floors, side by side."""
        pairs = zip(self.floors, self.plane_floors.shift, strict=True)
        parts = [shapely.transform(floor.free_space, lambda x, shift=shift: x + shift) for floor, shift in pairs]
        return Workspace.from_polygons(parts, self.plane_floors.domain, squeeze=self.floors[0].squeeze)

    @cached_property
    def corners(self) -> CornerVisibility:
        """The corners of all floors, the ends of links, and what each corner or end sees; all goals share it."""
        corners, mesh, arcs = CornerVisibility.of(self.plane), self.plane.triangulation, self.plane_floors.arcs
        if not arcs:
            return corners
        # Ends of links at one place, up to the rounding of the triangulation, are one corner.
        ends = np.stack([self._place_in_plane(place) for _, link in arcs for place in (link.start, link.end)])
        _, first, place = np.unique(mesh.place(ends).x, axis=0, return_index=True, return_inverse=True)
        lengths = np.array([link.cost for _, link in arcs])
        return with_places(corners, mesh, ends[first], Arcs(place[0::2], place[1::2], lengths))

    def in_plane(self, floor: ArrayLike, x: ArrayLike) -> np.ndarray:
        """Return points of floors as points of ``plane``, in which all floors lie side by side.

        Points of 32-bit floats first move into their floor's free space as by :meth:`Workspace.settled`.
        """
        if _arrays.is_traced(floor) or _arrays.is_traced(x):
            return self.plane_floors.in_plane(floor, x)
        floor, x = np.asarray(floor), _arrays.as_queries(x, 2)
        plane = self.plane_floors.in_plane(floor, x)
        if x.dtype != np.float32:
            return plane
        floors, single = np.broadcast_arrays(floor[..., None], x)
        floor, x = floors[..., 0], single.astype(np.float64)
        for k, workspace in enumerate(self.floors):
            x[floor == k] = workspace.settled(single[floor == k])
        return self.plane_floors.in_plane(floor, x)

    def _place_in_plane(self, place: Place) -> np.ndarray:
        """Return a free place as a point of ``plane``, moved into the bounds if it is outside by rounding."""
        (floor, point), floors = place, self.plane_floors
        return self.in_plane(floor, np.clip(point, floors.lo[floor], floors.hi[floor]))

    def oracle(self, floor: Any, goal: ArrayLike | None = None, offsets: ArrayLike | None = None) -> "BuildingOracle":
        """Return the function of exact distances to a goal ``(x, y)`` on a floor, over floors and links.

        For the nearest of several goals, pass a list of pairs: ``building.oracle([(0, (1, 2)), (3, (4, 5))])``.
        ``offsets`` are the costs of using each goal, such as queues at exits, finite and at least 0. Distances
        include the offsets, lengths of routes do not. All oracles of a building share its preprocessing.
        ``ValueError`` if a goal is not in free space, or for other ``offsets``.
        """
        pairs = [(floor, goal)] if goal is not None else floor
        if not isinstance(pairs, Sequence) or not pairs:
            form = "a floor and a goal (x, y), or a list of pairs (floor, (x, y))"
            raise ValueError(f"oracle needs {form}, got {shortened(pairs)}.")
        goals = tuple(as_place(f"Goal {i}", pair) for i, pair in enumerate(pairs))
        for i, place in enumerate(goals):
            self._require_free(f"Goal {i}", place)
        points, costs = np.stack([self._place_in_plane(place) for place in goals]), as_offsets(offsets, len(goals))
        return BuildingOracle(self, goals, NearestPaths.of(self.plane, self.corners, points, costs))


@dataclass(frozen=True, eq=False)
class BuildingOracle:
    """Exact distance from points of a building's floors to the nearest of one or more goals.

    :meth:`Building.oracle` makes it. A path may take any number of links.

    Attributes:
        building: The building.
        goals: Floor and point of each goal.
        paths: The distance function in ``building.plane``.
    """

    building: Building = field(repr=False)
    goals: tuple[Place, ...]
    paths: NearestPaths = field(repr=False)
    is_lower_bound: ClassVar[bool] = True

    @cached_property
    def floors(self) -> Floors:
        return replace(self.building.plane_floors, num_goals=len(self.goals))

    def __call__(self, floor: ArrayLike, x: ArrayLike) -> Distances:
        """Return the distance from points ``x`` ``(n, 2)`` of floors, an index or ``(n,)``, to the nearest goal.

        Distances ``(n,)`` are lengths plus the costs of links and the goal's offset, in the units of the floors;
        ``inf`` without a path, in obstacles, and outside the floor's bounds. ``ValueError`` for another shape or an
        unknown floor.
        """
        return self.paths(self.building.in_plane(floor, x))

    def which(self, floor: ArrayLike, x: ArrayLike) -> Int[np.ndarray, " n"]:
        """Return the index of the link that each shortest path takes first, ``(n,)``.

        It is -1 if the path takes no link, whichever the goal (see :meth:`nearest_goal`), and -2 without a path.
        """
        return self.floors.next_links(self.paths.which(self.building.in_plane(floor, x)))

    def nearest_goal(self, floor: ArrayLike, x: ArrayLike) -> Int[np.ndarray, " n"]:
        """Return the index in ``goals`` of the goal where each shortest path ends, ``(n,)``; -1 without a path."""
        source, _ = self.paths.first_turns(self.building.in_plane(floor, x))
        # Roots are their own parents, and paths go on from there at their exits.
        ends = path_ends(np.asarray(self.paths.sources.exits)[self.paths.sources.parents])
        return np.where(source < 0, -1, self.paths.root_numbers[ends[source]])

    def shortest_path(self, floor: int, x: ArrayLike) -> Route:
        """Return the shortest path from a point ``(2,)`` of a floor to the nearest goal, where its last leg ends."""
        _arrays.as_point("The start", x, 2)
        start = self.building.in_plane(floor, np.asarray(x)[None])
        (source,), _ = self.paths.first_turns(start)
        return self.floors.route(int(floor), start[0], int(source), self.paths.sources)

    def __getitem__(self, floor: int) -> NearestGoal:
        """Return the distance function of one floor, from points ``(n, 2)``; ``construct`` and others take it.

        The function has as goals the goals on the floor, and the starts of links that shortest paths take. The offset
        of a link's start is its distance to the nearest goal of the building. ``ValueError`` if no goal can be
        reached from the floor.
        """
        building, sources, numbers = self.building, self.paths.sources, self.paths.root_numbers
        _arrays.require_integer("floor", floor, 0)
        if floor >= len(building.floors):
            raise IndexError(f"The building has floors 0 to {len(building.floors) - 1}, got {floor}.")
        bounds, shift = building.floors[floor].bounds, building.plane_floors.shift[floor]
        # Roots are at goals and at the starts of links. Shifts are rounded, so points may be just outside the bounds.
        places = [*self.goals, *(link.start for _, link in self.floors.arcs)]
        root = np.flatnonzero((numbers >= 0) & (np.array([k for k, _ in places])[numbers] == floor))
        if not len(root):
            raise ValueError(f"No goal can be reached from floor {floor}.")
        first, *others = np.clip(sources.points[root] - shift, bounds.lo, bounds.hi)
        graph: Any = VisibilityGraph(building.floors[floor], first)
        return NearestGoal([graph, *map(graph.with_goal, others)], sources.distances[root])

    def construct(self, leaf: Any = "cone", *, max_bytes: Any = None, **options: Any) -> "BuildingPLR":
        """Build one PLR of all floors; ``leaf``, ``max_bytes`` and ``options`` are those of :func:`construct`.

        For bounds, pass ``certified=True``. All floors share one budget of bytes or leaves, which goes to the largest
        errors. ``max_bytes`` limits the whole file, with its floors and links. Raises what :func:`construct` raises.
        """
        from plr_jax.buildings.building_plr import BuildingPLR  # imports JAX
        from plr_jax.plr import construct, growth

        other_bytes = len(self.floors.to_bytes())
        rest = max(1, max_bytes - other_bytes) if isinstance(max_bytes, int) else max_bytes
        try:
            plane = construct(self.paths, self.building.plane.bounds, leaf=leaf, max_bytes=rest, **options)
        except growth.BudgetTooSmall as error:
            raise growth.BudgetTooSmall(float(max_bytes), error.num_bytes + other_bytes) from None
        return BuildingPLR(self.floors, plane)
