"""The arithmetic of a query, part of the file format: every reader that keeps to it answers alike, bit for bit.

``plr.numpy()`` and ``plr.c_header(name)`` keep to it. So does ``plr(x)`` in 32 bits on a CPU, whatever it is compiled
into, but that XLA takes numbers below 1e-38 for 0; in a domain far from the origin of points of NumPy alone, whose
folding and wrapping in 64 bits may be rounded otherwise. The vectors in ``tests/plr/vectors`` hold answers.

All operations are those of IEEE 754, rounded to nearest, none fused, in 32-bit floats unless 64 are named; what is
written ``a + b + c`` is computed from left to right. What is called a *number* is computed once from the file, in 64
bits unless stated, and rounded to 32 once.

**The domain.** ``LO`` and ``HI`` are the corners of the file's domain ``lo``, ``hi``, rounded outward: the next
32-bit float beyond, where a corner is none. Further numbers, one an axis: ``LO_REST = lo - LO`` and ``HI_REST = HI -
hi``, rounded toward zero by the next float below the nearest (0 if that is negative), ``SCALE = 1 / (hi - lo)``,
``START = 1 - (lo - LO) / (hi - lo)``, and ``TOP``, the largest 32-bit float not above ``2 - 2**-23 - START``.

1.  *Placing.* A domain is *far* if on some axis ``max(|LO|, |HI|) > 4 (HI - LO)``. Points of 64 bits first have
    their finite coordinates along periodic axes wrapped (step 3, in 64 bits, with ``lo``, ``hi`` and ``1 / (hi -
    lo)`` as they are and tolerance 0). In a far domain points are then counted from ``LO``: ``x - LO`` in 64 bits,
    and of the numbers above ``LO`` becomes 0 and ``HI`` becomes ``HI - LO``; or, if points are folded, they are
    folded in 64 bits (step 2). Then coordinates are rounded to 32 bits. Points of 32 bits in a far domain are first
    made 64 bits.
2.  *Folding*, where the file has one. ``z = x - CENTER - REST``, of which ``REST`` is what the rounded center leaves
    of it (in 64 bits there is none); along turned axes, each ``AXES[i, 0] z[0] + AXES[i, 1] z[1] + ...``; for each
    mirror in the file's order, if its pivot is below 0 the coordinates it reverses change their signs; then those
    along axes that are not periodic are limited to the corners of the folded box, rounded to nearest. In what
    follows ``lo`` and ``hi`` are of that box.
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
7.  If the folding is radial, ``+ sqrt(z[i] z[i] + z[j] z[j] + ...)`` of its radial axes is added.

The answer is NaN if a coordinate is NaN; else ``inf`` unless, before folding, ``LO <= x <= HI`` along each axis that
is not periodic and ``x`` is finite along the others (in a far domain: of ``x - LO``, rounded; if points are folded,
``lo <= x <= hi`` in 64 bits). A waypoint is ``LO + n[1:]``, in a far domain in 64 bits.

**Numbers of leaves**, in 64 bits, in the traversal of the tree. With the leaf's box ``[l, h]`` along each axis, ``l
= lo + (hi - lo) (p 2**-k)``, ``h = lo + (hi - lo) ((p + 1) 2**-k)``:

-   *Planes*, of a center ``c`` and half-differences ``g`` (``offset + step * code`` and ``step * code``): slopes
    ``s = g * 2 / (h - l)``, and ``n[0] = c - (s[0] m[0] + s[1] m[1] + ...)`` with ``m = (l + h) / 2 - LO``.
-   *Cones*: the source less ``LO``, and its offset: ``sqrt`` of the squares of the way to its parent, summed axis by
    axis, added along the parents by doubling (see ``leaves/cone/codec.py``), plus that of the root.
-   *Polynomials*: each value at a corner is the sum, in the order of the free values, of weights times free values
    (see ``leaves/continuous/space.py``); powers of ``t`` are sums of those, in the order of corners, with whole
    numbers as weights.
-   A leaf that nothing reaches continues its neighbor's (mean) plane: see ``plr/_filled.py``.
"""
