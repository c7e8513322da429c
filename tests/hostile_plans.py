"""Small hostile workspaces on which the answers of the package are compared with an exact oracle.

``python tests/hostile_plans.py --plans 2000`` makes random workspaces with shared vertices, collinear walls, touching
corners, walls along the bounds, spikes, and slivers and gaps of 1 to 10 tolerances. Goals lie beside walls, their
ends, corners and contacts. It counts wrong answers, broken bounds, hangs and refusals.

A point stands for all points within the tolerance. An answer is wrong if it lies outside the interval of the exact
answers of these points. For 32-bit points, the tolerance is the resolution of 32-bit floats. Bounds must hold for the
points themselves, in free space as the workspace rounds it. Rounding may lose only thin walls and gaps.
"""

import argparse
import signal
import tempfile
import time
import warnings
from collections import Counter
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import product
from pathlib import Path

import numpy as np
import shapely
from exact_plane import ExactPlane, as_exact

from plr_jax import VisibilityGraph, Workspace, construct, construct_pairs

_ASKED = ["oracle", "fields", "pairs"]  # the oracle, certified PLRs of one goal per plan, pairs
_HANGS = 60  # CPU seconds after which a plan counts as hanging
_NEAR = 2  # tolerances: points closer to a wall may lie on either side of it
_ROUNDED = 0.1  # tolerances: more than the workspace moves walls by rounding
_VANISHES = 0.5  # tolerances: thinner walls and gaps may vanish
_NEAR_32 = 1e-7  # the same for 32-bit points, in widths of the workspace
_NEAR_PAIRS, _SLACK_PAIRS = 8e-6, 2e-5  # documented resolution and error of pairs, in widths
_SHARP = 0.6  # cosine of the angle below which the tip of an obstacle counts as thin
_OFFSETS = [0, 0.5, 1, 2, 3]  # distances of points from walls and their ends, in tolerances
_STEPS = [1e-6, 1e-3]  # more of these distances, in widths


@dataclass(frozen=True)
class Plan:
    """Arguments of a workspace, goals and query points."""

    bounds: tuple
    obstacles: list
    goals: np.ndarray
    points: np.ndarray
    tolerance: float


def hostile_plan(seed, number, goals=6, points=24):
    rng = np.random.default_rng([seed, number])
    kind = rng.choice(["lattice", "decimals", "floats"])
    lo, hi = {"lattice": ((0, 0), (8, 6)), "decimals": ((0, 0), (1, 1)), "floats": ((-3.7, 2.1), (5.3, 9.4))}[kind]
    lo, hi = np.array(lo, float), np.array(hi, float)
    tolerance = 1e-9 * float((hi - lo).max())

    def place(count):
        if kind == "floats":
            return lo + rng.random((count, 2)) * (hi - lo)
        parts = 1 if kind == "lattice" else 1000
        return rng.integers(0, np.rint((hi - lo) * parts).astype(int) + 1, (count, 2)) / parts

    rings = []
    ways = ["rectangle", "polygon", "touching", "opposite", "collinear", "flush", "spike", "sliver", "slanted", "gap"]
    for _ in range(rng.integers(2, 8)):
        way = str(rng.choice(ways, p=np.array([3, 2, 3, 3, 2, 2, 1, 1, 1, 1]) / 19))
        ring = _ring_of(way, rng, place, rings, lo, hi, tolerance)
        polygon = shapely.Polygon(ring)
        scale = np.ptp(ring, axis=0).max()
        if polygon.is_valid and polygon.area > 1e-11 * scale**2 and len(np.unique(ring, axis=0)) == len(ring):
            rings.append(ring)
    outline = [_rectangle(lo, hi), *rings]
    walls = np.concatenate([np.stack([ring, np.roll(ring, -1, axis=0)], axis=1) for ring in outline])
    near = _points_beside(walls, 8 * (goals + points), rng, tolerance, (hi - lo).max()).clip(lo, hi)
    blocked = shapely.buffer(shapely.union_all([shapely.Polygon(ring) for ring in rings]), -tolerance / 2)
    near = near[~shapely.intersects_xy(blocked, *near.T)]
    far = lo + rng.random((points, 2)) * (hi - lo)
    far = far[~shapely.intersects_xy(blocked, *far.T)]
    points = np.concatenate([far, near[goals : goals + points - len(far) // 2]])
    return Plan((lo, hi), rings, near[:goals], points, tolerance)


def _rectangle(a, b):
    (x0, y0), (x1, y1) = np.minimum(a, b), np.maximum(a, b)
    return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])


def _star(ring):
    """Return the corners in the order of their directions from the middle."""
    return ring[np.argsort(np.arctan2(*(ring - ring.mean(axis=0)).T[::-1]))]


def _with_axis(point, axis, value):
    return np.where(np.arange(2) == axis, value, point)


def _ring_of(way, rng, place, rings, lo, hi, tolerance):
    """Return a random ring, placed in some way beside the rings so far."""
    a, b, c = place(3)
    thin = rng.uniform(1, 10) * tolerance
    old = rings[rng.integers(len(rings))] if rings else _rectangle(a, c)
    vertex = old[rng.integers(len(old))]
    if way == "rectangle":
        return _rectangle(a, b)
    if way == "polygon":
        return _star(place(int(rng.integers(3, 6))))
    if way == "touching":
        return _star(np.stack([vertex, a, b]))
    if way == "opposite":  # a rectangle that shares a corner with another ring
        return _rectangle(vertex, a)
    if way == "collinear":  # a rectangle with a side through a vertex of another ring
        axis = rng.integers(2)
        return _rectangle(_with_axis(a, axis, vertex[axis]), b)
    if way == "flush":  # a rectangle with a side on the bounds
        axis, end = rng.integers(2), rng.choice([lo, hi])
        return _rectangle(_with_axis(a, axis, end[axis]), b)
    along = b - a if np.any(b != a) else np.array([1.0, 0.0])
    across = np.array([-along[1], along[0]]) / np.hypot(*along)
    if way == "spike":
        foot = vertex if rng.random() < 0.5 else a
        return np.stack([foot, foot + thin * across, foot + along * rng.uniform(0.2, 1)])
    if way == "sliver":
        axis = rng.integers(2)
        corner = rng.choice([vertex, a])
        return _rectangle(corner, _with_axis(b, axis, corner[axis] + thin))
    if way == "slanted":
        return np.stack([a, b, b + thin * across, a + thin * across])
    # A gap: a rectangle just beside the upper end of another ring.
    axis, low, high = rng.integers(2), old.min(axis=0), old.max(axis=0)
    begin = high[axis] + thin
    return _rectangle(_with_axis(low, axis, begin), _with_axis(high, axis, begin + abs(b - a)[axis]))


def _points_beside(walls, count, rng, tolerance, width):
    """Return points beside walls, their ends and corners."""
    points = []
    for start, end in rng.permutation(walls)[np.arange(count) % len(walls)]:
        along = (end - start) / np.hypot(*(end - start))
        across = np.array([-along[1], along[0]])
        offsets = [tolerance * each for each in _OFFSETS] + [each * width for each in _STEPS]
        away = rng.choice(offsets) * rng.choice([-1, 1])
        how = rng.choice(["wall", "end", "vertex"], p=[0.4, 0.4, 0.2])
        if how == "wall":
            points.append(start + rng.random() * (end - start) + away * across)
        elif how == "end":
            points.append(start + rng.choice(offsets) * rng.choice([1, 1, -1]) * along + away * across)
        else:
            angle = rng.uniform(0, 2 * np.pi)
            points.append(start + away * np.array([np.cos(angle), np.sin(angle)]))
    return np.array(points)


@dataclass
class Judge:
    """Exact answers for a plan, and the wrong answers of the package."""

    plan: Plan
    boundary: np.ndarray
    counts: Counter[str] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)

    @cached_property
    def given(self):
        return ExactPlane(self.plan.bounds, self.plan.obstacles)

    @cached_property
    def rounded(self):
        """Return the plane after rounding by the workspace."""
        return ExactPlane(self.boundary)

    def free_space(self, rounded):
        """Count walls and gaps that vanished by rounding although they are thicker than documented.

        Also count outlines of free space that are not the walls by which bounds are judged.
        """
        self.counts["free space: asked"] += 1
        walls = shapely.multilinestrings(shapely.linestrings(self.boundary))
        if shapely.length(shapely.symmetric_difference(walls, shapely.boundary(rounded))) > 1e-12 * walls.length:
            self.fail("free space: other walls")
        solid = shapely.union_all([shapely.Polygon(ring) for ring in self.plan.obstacles])
        given = shapely.box(*np.ravel(self.plan.bounds)) - solid
        for kind, lost in (("wall", rounded - given), ("gap", given - rounded)):
            thick = shapely.buffer(lost, -_VANISHES / 2 * self.plan.tolerance)
            if not thick.is_empty:
                self.fail(f"free space: a {kind} vanished", thick.bounds[:2], thick.bounds[2:])

    def interval(self, plane, x, y, radius, in_sectors=False):
        """Return the least and largest distance between points within a radius of both ends."""
        starts, ends = ([each, *plane.near(each, radius, in_sectors=in_sectors)] for each in (x, y))
        values = np.concatenate([plane.distances(each, ends) for each in starts])
        return float(values.min()), float(values.max())

    def values(self, name, goal, x, got, exact, slack, radius, in_sectors=False):
        """Count wrong values; with ``in_sectors``, the values of all sectors beside a contact count as right."""
        self.counts[f"{name}: asked"] += len(x)
        with np.errstate(invalid="ignore"):
            doubtful = ~((got == exact) | (np.abs(got - exact) <= slack))
        for i in np.flatnonzero(doubtful):
            allowed = [self.interval(plane, goal, x[i], radius, in_sectors) for plane in (self.given, self.rounded)]
            if any(lo - slack <= got[i] <= hi + slack for lo, hi in allowed):
                self.counts[f"{name}: within the tolerance"] += 1
            else:
                self.fail(f"{name}: wrong", goal, x[i], got[i], exact[i], allowed[0])

    def pairs(self, goal, x, got, exact, width):
        """Count wrong pair distances; too short ones beside walls that 32 bits do not resolve have their own name."""
        radius, slack = _NEAR_PAIRS * width, _SLACK_PAIRS * width
        may_lack = np.array([self._is_thin_at(point, radius) for point in [goal, *x]])
        may_lack = (may_lack[0] | may_lack[1:]) & (got < exact + slack)
        self.counts["pairs: too short, where 32 bits do not resolve"] += int((may_lack & (got < exact - slack)).sum())
        self.values("pairs", goal, x[~may_lack], got[~may_lack], exact[~may_lack], slack, radius, True)

    def _is_thin_at(self, x, radius):
        """Return whether two walls, or both walls of a thin tip, are within the radius."""
        near = self.boundary[shapely.dwithin(shapely.linestrings(self.boundary), shapely.Point(x), radius)]
        for one in near:
            for other in near:
                shared = (one[:, None] == other).all(axis=2)
                if not shared.any():
                    return True
                if shared.sum() == 1:
                    (i,), (j,) = np.nonzero(shared)
                    u, v = one[1 - i] - one[i], other[1 - j] - other[j]
                    if u @ v > _SHARP * np.hypot(*u) * np.hypot(*v):
                        return True
        vertices = {tuple(end) for wall in near for end in wall.tolist() if np.hypot(*(end - x)) <= radius}
        return any(len(self.rounded.sectors_at(as_exact(vertex))) > 1 for vertex in vertices)

    def bounds(self, name, goal, x, got, slack, everywhere=False):
        """Count broken bounds; bounds that hold within the tolerance, or for 32-bit points, have separate names.

        With ``everywhere``, upper bounds must be ``inf`` at points that cannot be reached, where others mean nothing.

        The proof is for the free space of the workspace, in which walls thinner than its rounding have vanished. The
        goal of an oracle that is within the tolerance of a contact or a wall has moved there (:meth:`placed`).
        """
        lower, upper = (np.asarray(each, float) for each in got)
        exact = self.rounded.distances(goal, [self.placed(each, _ROUNDED * self.plan.tolerance) for each in x])
        judged, width = np.isfinite(exact) | everywhere, float(np.ptp(self.boundary.reshape(-1, 2), axis=0).max())
        self.counts[f"{name}: asked"] += int(judged.sum())
        for i in np.flatnonzero(judged & ((lower > exact + slack) | (upper < exact - slack))):
            radii = {
                "broken, but within the tolerance": _NEAR * self.plan.tolerance,
                "broken, but for 32 bits": _NEAR_32 * width,
            }
            allowed = {kind: self.interval(self.rounded, goal, x[i], radius) for kind, radius in radii.items()}
            holds = (kind for kind, (lo, hi) in allowed.items() if lower[i] <= hi + slack and upper[i] >= lo - slack)
            self.fail(f"{name}: {next(holds, 'broken')}", goal, x[i], (lower[i], upper[i]), exact[i], allowed)

    def placed(self, x, radius):
        """Return the contact within a radius or, for a point in an obstacle, the nearest point of its walls."""
        near = self.rounded.near(x, radius)
        contacts = [point for point in near if len(self.rounded.sectors_at(as_exact(point))) > 1]
        if not contacts and self.rounded.sectors_at(as_exact(x)):
            return x
        return min(contacts or near, key=lambda point: np.hypot(*(np.array(point, float) - x)), default=x)

    def sight(self, name, goal, x, got):
        self.counts[f"{name}: asked"] += len(x)
        for each, answer in zip(x, got, strict=True):
            if bool(answer) != self.given.sees(goal, each) and not self._may_see(goal, each, bool(answer)):
                self.fail(f"{name}: wrong", goal, each, bool(answer), not answer)

    def _may_see(self, a, b, answer):
        """Return whether a segment or a free path within the tolerance of the given segment has this answer."""
        radius, way = _NEAR * self.plan.tolerance, b - a
        if np.hypot(*way) <= 4 * radius:
            return True
        across = radius * np.array([-way[1], way[0]]) / np.hypot(*way)
        for plane in (self.given, self.rounded):
            starts, ends = ([p, *plane.near(p, radius), p + across, p - across] for p in (a, b))
            if any(plane.sees(p, q) == answer for p in starts for q in ends):
                return True
            # A point in an obstacle is treated as the nearest point of free space.
            on_walls = ([x] if plane.sectors_at(as_exact(x)) else plane.near(x, self.plan.tolerance) for x in (a, b))
            if answer and any(plane.joins(p, q, self.plan.tolerance) for p, q in product(*on_walls)):
                return True
        return False

    def fail(self, kind, goal=None, x=None, got=None, exact=None, allowed=None):
        self.counts[kind] += 1
        rings = [ring.tolist() for ring in self.plan.obstacles]
        bounds = [end.tolist() for end in self.plan.bounds]
        self.failures.append(
            f"# {kind}: got {got}, right {exact}, of points within the tolerance {allowed}\n"
            f"workspace = Workspace({bounds}, {rings})\n"
            f"goal, x = {np.asarray(goal, float).tolist()}, {np.asarray(x).tolist()}"
        )


def judge(plan, ask):
    """Compare all answers of the package about a plan."""
    workspace = Workspace(plan.bounds, plan.obstacles)
    result = Judge(plan, workspace.boundary.segments)
    result.free_space(workspace.free_space)
    width, x = float(workspace.bounds.width.max()), plan.points
    radius, slack = _NEAR * plan.tolerance, 4 * plan.tolerance
    goals = [goal for goal in plan.goals if workspace.is_free(goal[None])[0]]
    if not goals:
        result.counts["plans without a goal"] += 1
        return result
    oracle = VisibilityGraph(workspace, goals[0])
    exact = [result.given.distances(goal, x) for goal in goals]
    # Distances of pairs mean nothing for points in obstacles.
    is_free = np.array([bool(result.given.sectors_at(as_exact(each))) for each in x])
    pairs = None
    if "pairs" in ask:
        pairs = _refusing(result, "pairs", partial(construct_pairs, workspace, max_bytes=2**14))
    for number, (goal, right) in enumerate(zip(goals, exact, strict=True)):
        own = oracle.with_goal(goal)
        if "oracle" in ask:
            result.values("VisibilityGraph", goal, x, own(x), right, slack, radius)
            result.values("between", goal, x, own.between(x, np.tile(goal, (len(x), 1))), right, slack, radius)
            result.sight("is_visible", goal, x, workspace.is_visible(np.tile(goal, (len(x), 1)), x))
        if pairs is not None:
            numpy = pairs.numpy()
            if result.given.sectors_at(as_exact(goal)):
                got = np.asarray(numpy(x[is_free], goal), float)
                result.pairs(goal, x[is_free], got, right[is_free], width)
            start = result.placed(goal, _ROUNDED * plan.tolerance)
            result.bounds("bounds of pairs", start, x, numpy.bounds(x, goal), slack, True)
        if number or "fields" not in ask or not np.isfinite(own(x)).any():
            continue
        for leaf, most in (("cone", 120), ("cone", 1000), ("plane", 400)):
            name = f"{leaf}s of {most} bytes"
            make = partial(construct, own, workspace.bounds, leaf=leaf, max_bytes=most, certified=True)
            plr = _refusing(result, name, make)
            if plr is not None:
                result.bounds(name, result.placed(goal, plan.tolerance), x, plr.numpy().bounds(x), slack)
    return result


def _refusing(result, name, make):
    """Return the result of ``make``, or None if it raises a ``ValueError``."""
    result.counts[f"{name}: made"] += 1
    try:
        if signal.getitimer(signal.ITIMER_PROF)[0]:  # trial limits the time, a test does not
            signal.setitimer(signal.ITIMER_PROF, _HANGS)
        return make()
    except RuntimeError as error:
        result.fail(f"{name}: {error}", result.plan.goals[0], result.plan.points[0])
    except ValueError as error:
        result.counts[f"{name}: refused: {' '.join(str(error).split()[:12])}"] += 1


def trial(seed, number, ask):
    """Make and judge a plan; hangs and errors are counted as well."""
    plan = hostile_plan(seed, number)
    signal.setitimer(signal.ITIMER_PROF, _HANGS)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return judge(plan, ask)
    except ValueError as error:
        result = Judge(plan, np.zeros((0, 2, 2)))
        result.counts[f"refused: {' '.join(str(error).split()[:12])}"] += 1
        result.fail("refused", plan.goals[0], plan.points[0], str(error), None, None)
    except Exception as error:
        result = Judge(plan, np.zeros((0, 2, 2)))
        result.fail(f"{type(error).__name__}: {str(error)[:80]}", plan.goals[0], plan.points[0])
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    return result


def _give_up(*_):
    raise RuntimeError("hangs")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plans", type=int, default=2_000)
    parser.add_argument("--first", type=int, default=0, help="number of the first plan")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--ask", nargs="+", choices=_ASKED, default=_ASKED, help="what is asked")
    arguments = parser.parse_args()
    kept = Path(tempfile.mkdtemp(prefix="plr_jax_"))
    print(f"what fails is in {kept}", flush=True)
    signal.signal(signal.SIGPROF, _give_up)
    counts, began = Counter(), time.perf_counter()
    for number in range(arguments.first, arguments.first + arguments.plans):
        result = trial(arguments.seed, number, arguments.ask)
        counts += result.counts
        if result.failures:
            (kept / f"{number}.txt").write_text("\n\n".join(result.failures) + "\n")
        if (number + 1 - arguments.first) % 100 == 0 or number + 1 == arguments.first + arguments.plans:
            print(f"{number + 1 - arguments.first} plans, {time.perf_counter() - began:.0f} s")
            print("".join(f"  {name}: {count:,}\n" for name, count in sorted(counts.items())), flush=True)


if __name__ == "__main__":
    main()
