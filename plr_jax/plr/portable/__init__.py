"""The arithmetic of a query, part of the file format: every reader that keeps to it answers alike, bit for bit.

``plr.numpy()``, ``plr.c_header(name)`` and ``plr.js_module()`` keep to it. So does ``plr(x)`` in 32 bits on a CPU,
whatever it is compiled into, but that XLA takes numbers below 1e-38 for 0; in a domain far from the origin of points
of NumPy alone, whose folding and wrapping in 64 bits may be rounded otherwise. The vectors in
``tests/plr/vectors`` hold answers.

All operations are those of IEEE 754, rounded to nearest, none fused, in 32-bit floats unless 64 are named; what is
written ``a + b + c`` is computed from left to right. What is called a *number* is computed once from the file, in 64
bits unless stated, and rounded to 32 once.

**The domain.** ``LO`` and ``HI`` are the corners of the file's domain ``lo``, ``hi``, rounded outward: the next
32-bit float beyond, where a corner is none. Further numbers, one an axis: ``LO_REST = lo - LO`` and ``HI_REST = HI -
hi``, rounded toward zero by the next float below the nearest (0 if that is negative), ``SCALE = 1 / (hi - lo)``,
``START = 1 - (lo - LO) / (hi - lo)``, and ``TOP``, the largest 32-bit float not above ``2 - 2**-23 - START``.

A domain is *far* if on some axis ``max(|lo|, |hi|) > 4 (hi - lo)``, in 64 bits. Its points are counted from its
exact corner: the ``ORIGIN`` is ``lo``, and from step 2 on the domain is that from 0 to ``hi - lo``, of which are all
numbers above. Elsewhere the ``ORIGIN`` is 0, and nothing changes.

1.  *Placing.* Points of 32 bits in a far domain are first made 64 bits. Points of 64 bits have their finite
    coordinates along periodic axes wrapped (step 3, in 64 bits, with ``lo``, ``hi`` and ``1 / (hi - lo)`` as they are
    in the file and tolerance 0). Of points in a far domain ``x - ORIGIN`` is computed in 64 bits. Then coordinates
    are rounded to 32 bits.
2.  *Folding*, where the file has one. ``z = x - CENTER - REST``: ``CENTER`` is the center less the ``ORIGIN`` and
    ``REST`` what rounding leaves of that; along turned axes, each ``AXES[i, 0] z[0] + AXES[i, 1] z[1] + ...``; for
    each mirror in the file's order, if its pivot is below 0 the coordinates it reverses change their signs; then
    those along axes that are not periodic are limited to the corners of the folded box, rounded inward. In what
    follows the domain is that box, seen from its center, and the ``ORIGIN`` 0.
3.  *Wrapping* along each periodic axis. With ``a = LO + LO_REST``, ``b = HI - HI_REST`` and a tolerance of ``2**-44
    max(|a|, |b|)``: ``x`` is moved to ``x - floor((x - a) SCALE) (b - a)``, limited to ``a`` and ``b``; or to ``a``
    if ``x - b`` is within the tolerance.
4.  *Place.* ``share = (x - LO) SCALE``; the smaller of it and ``TOP``, plus ``START``, or 1 if that is more, is from
    1 to below 2. Its 23 bits behind the point are the place along the axis.
5.  *Leaf.* From the root, a node that is split along an axis leads to its upper child if the next bit of the place
    along it, the highest first, is set, else to its lower one.
6.  *Value*, of the leaf's numbers ``n``. A plane: ``n[0] + n[1] (x[0] - LO[0]) + n[2] (x[1] - LO[1]) + ...``. A
    cone: ``n[0] + sqrt(d[0] d[0] + d[1] d[1] + ...)`` with ``d[i] = (x[i] - LO[i]) - n[1 + i]``. A polynomial
    (continuous and smooth leaves): ``t = ((x - LO) SCALE + (START - 1)) 2**k - p`` along each axis, where the leaf
    is cell ``p`` of ``2**k``, and Horner's rule along the first axis, the highest power first, whose coefficients
    are polynomials of the others, by the same rule.

The answer is NaN if a coordinate is NaN; else ``inf`` unless, after step 1, ``LO <= x <= HI`` along each axis that is
not periodic, and ``x`` is finite along the others. A waypoint is ``LO + n[1:]``, in a far domain ``ORIGIN + n[1:]``
in 64 bits.

Readers may answer otherwise outside the domain, as ``outside="clamp"`` does: after step 1, if all coordinates are
finite, those along axes that are not periodic are limited to ``LO`` and ``HI``, and to the value there is added how
far that moved the point, by differences ``m``: ``s sqrt((m[0] / s) (m[0] / s) + (m[1] / s) (m[1] / s) + ...)``, where
``s`` is the largest ``|m[i]|``, or 1 if that is 0.

**Numbers of leaves**, in 64 bits, in the traversal of the tree. With the leaf's box ``[l, h]`` along each axis, ``l
= lo + (hi - lo) (p 2**-k)``, ``h = lo + (hi - lo) ((p + 1) 2**-k)``:

-   *Planes*, of a center ``c`` and half-differences ``g`` (``offset + step * code`` and ``step * code``): slopes
    ``s = g * 2 / (h - l)``, and ``n[0] = c - (s[0] m[0] + s[1] m[1] + ...)`` with ``m = (l + h) / 2 - (ORIGIN +
    LO)``; ``l`` and ``h`` are of the domain as the file has it.
-   *Cones*: the source less ``ORIGIN + LO``, and its offset: ``sqrt`` of the squares of the way to its parent, summed
    axis by axis, added along the parents by doubling (see ``leaves/cone/codec.py``), plus that of the root.
-   *Polynomials*: see below.
-   A leaf that nothing reaches continues its neighbor's (mean) plane: see ``plr/_file.py``.

**Polynomials.** A leaf has a number at each corner, its value there; a smooth leaf has one of each *kind* there, the
derivative by ``t`` along some axes, along none the value. Corners (0 for the lower end along an axis, 1 for the upper
one) and kinds (1 for an axis along which it is) are in the order of binary numbers, the first axis highest, and a
corner's kinds stand together. There are ``P**dim`` coefficients, where ``P`` is 2, of smooth leaves 4; that of
``t[0]**i t[1]**j t[2]**k ...`` is the one with the index ``((i P + j) P + k) ...``. It is the sum, in the order of
the leaf's numbers, of each times the product of what that power has along each axis in ``1 - t`` at the lower and
``t`` at the upper end; of smooth leaves, for a kind that is not along the axis, in ``1 - 3 t**2 + 2 t**3`` and ``3
t**2 - 2 t**3``, and for one that is, in ``t - 2 t**2 + t**3`` and ``t**3 - t**2``.

The numbers follow from the free values, ``offset + step * code``, in 64 bits:

1.  *Groups.* Nodes are the corners of leaves, leaf by leaf. The *points* of a tied face are the corners of the piece
    that its leaves share. They are sorted by the face's axis, lower leaf and upper leaf; across the seam of a
    periodic axis the lower leaf is the one at the upper end. Where a point is a corner of both leaves, these nodes
    are in one group. Groups are numbered in the order of their first nodes. A group with a node at a point that is a
    corner of its leaf alone *hangs* there on the other leaf: at the first such point where it is the lower leaf's
    corner, else at the first of all.
2.  *Values.* A hanging group has the value there of the multilinear function of the leaf that it hangs on. So all
    values are combinations of those of groups that do not hang.
3.  *Equations*, in 3 dimensions and more. For each point that is not a corner of both leaves, in order: the value
    there of the lower leaf's function minus that of the upper one's is a combination of groups, those replaced that
    an earlier equation gave up. If it does not vanish, it gives up its group of the highest level, of those the one
    of the largest weight either way, of those the first; which is replaced in all earlier ones too. A group's level
    is the sum over the axes of the exponents of the denominators of its point, a fraction of the domain.
4.  *Free values* are those of the groups of reachable leaves that neither hang nor were given up, in the order of
    their levels, then of their numbers.
5.  *Derivatives* of smooth leaves are first by fractions of the domain. Of a group that does not hang, those of a
    kind are the mean over its nodes of the difference of the leaf's values, upper minus lower ones along the kind's
    axes, over the product of the leaf's widths along them; each node weighs one over that product. A group that
    hangs has the value and the derivatives there of the cubic function of the leaf that it hangs on. By ``t``, they
    are multiplied by the product of the leaf's widths along the kind's axes.
6.  Each number of a leaf is then a combination of free values: the sum, in their order, of weights times values.

In continuous leaves without equations, weights are whole multiples of powers of two, and exact. Others are rounded by
the operations of ``plr_jax/plr/leaves/continuous``. A reader that rounds them otherwise has numbers that are equal
but for 1e-14 of the largest: of those halfway between two 32-bit floats, some are then rounded the other way, and
rarely so is an answer.
"""
