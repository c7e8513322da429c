"""Shortest paths between all pairs of cells of a grid, exact, from a file of a few kilobytes: the map.

A *corner* is a free cell with a blocked cell diagonally beside it, and free cells on both sides of that one. The
*open length* of two cells is that of a shortest path without obstacles. They *see* each other if all paths of open
length between them consist of legal steps: on 4-connected grids if the rectangle of cells between them is free; on
8-connected ones if the parallelogram is, and the steps along its slanted sides cut no corner.

Theorem 1. If cells x and y are joined but do not see each other, a shortest path passes a corner between them.

Proof. Say no path has the open length. Then a shortest path P has two steps that no path of open length has both; let
a and b be two such with fewest steps between, which are then alike. If there are none between, the grid is
8-connected and P turns at a right angle from one straight step to another, as any other such turn could be cut short;
so could this one, unless the cell inside is blocked, and then P turns at a corner. Else P leaves a line, goes along
beside it, and returns to it: east, north, west on a 4-connected grid; north-east, east, south-east or east,
north-east, north on an 8-connected one. The line would be shorter, so a cell beside P that a step along it needs is
blocked: in the first two cases not one next to the ends, which a legal step of P needs, so that P passes a corner
where the blocked ones begin; in the third one with two neighbors on P or beside a legal step of it, at a corner of P.

Now say P has the open length, of steps of two kinds, E and N (or E and NE, or likewise in another sector). In
coordinates that count them, P is a staircase in a rectangle. Exchange an E followed by an N for N, E while the new
steps are legal; they are unless the cell north-west of the turn is blocked (of NE, too: its other neighbors are those
of a legal step), and then the turn is a corner. If this never happens, neither with N before E, the staircase has
swept the rectangle by legal steps, and x and y see each other.

So there are shortest paths x, c_1, ..., c_m, y over corners of which each cell sees the next. A cell p is *taut* at a
corner c that it sees, if c has a blocked diagonal (k, l) with exactly one of k (p - c)_1 and l (p - c)_2 positive: a
path from p through c can wrap around that blocked cell, from p's side to the other.

Theorem 2. If x and y are joined but do not see each other, there is such a path with m at least 1 in which both
neighbors of every corner are taut at it.

Proof. Take one with the fewest corners that are not so; let c be one of these, between a and b. If the grid is
8-connected and the last step of some path of open length from a makes a right angle with the first of some to b, the
cell inside of it is blocked as above, and a and b are taut at c. Otherwise, as no turn can be cut short, all steps
from a to c and on to b are of two kinds, and in coordinates that count them a <= c <= b. The
rectangle from a to b has four quarters at c, of which those towards a and b have legal steps only. If the other two
have as well, a sees b: leave c out. If both of them are wider than a line, all straight neighbors of c are free, so
that, as c is a corner, it has a blocked diagonal in one of them, at which a and b are taut. So there is one that is
wider than a line; exchange steps in it as above, beginning along its sides through c. This ends at turns around
blocked diagonals, of which there is one at least, and none at c, where a and b are not taut. Put them in the place
of c: each sees the next, since steps in
between have been swept; both neighbors of each are taut at it. If c was taut at a, so is now the cell after a: it is
in the same sector, or has moved from its edge to its inside, which the blocked diagonal of a would have prevented; so
are b and its neighbor. Hence fewer corners are not taut, a contradiction.

Theorem 3. Let S(x) be the corners at which x is taut, but for those with another such corner on a path of open length
from x. If x and y see each other, their distance is the open length o(x, y); else it is the least o(x, i) + D(i, j) +
o(j, y) over i in S(x) and j in S(y), with the distance D of corners, and ``inf`` if there is none.

Proof. Each sum is the length of a path, so none is below the distance. By Theorem 2 the sum of c_1 and c_m is the
distance. If another corner at which x is taut is on a path of open length from x to c_1, its sum with c_m is no
larger, by the triangle inequality; the nearest such is in S(x). Likewise for y.

Hence answers are never above the truth, and never below but for rounding: a diagonal step counts 1393 / 985, which is
less than the square root of 2 by 3.6e-7, and what a query rounds is rounded down.

References:
    Uras, Koenig and Hernandez, "Subgoal graphs for optimal pathfinding in eight-neighbor grids", ICAPS 2013: corners
    of obstacles as subgoals, of which each cell lists those that it reaches directly. Harabor and Grastien, "Online
    graph pruning for pathfinding on grid maps", AAAI 2011: turns that shortest paths need.
"""
