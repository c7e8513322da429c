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
7.  If the folding is radial, ``+ sqrt(z[i] z[i] + z[j] z[j] + ...)`` of its radial axes is added.

The answer is NaN if a coordinate is NaN; else ``inf`` unless, after step 1, ``LO <= x <= HI`` along each axis that is
not periodic, and ``x`` is finite along the others. A waypoint is ``LO + n[1:]``, in a far domain ``ORIGIN + n[1:]``
in 64 bits.

Readers may answer otherwise outside the domain, as ``outside="clamp"`` does: after step 1, if all coordinates are
finite, those along axes that are not periodic are limited to ``LO`` and ``HI``, and to the value there is added how
far that moved the point: ``sqrt(m[0] m[0] + m[1] m[1] + ...)`` in 64 bits, of differences ``m`` of 32 bits, rounded.

**Numbers of leaves**, in 64 bits, in the traversal of the tree. With the leaf's box ``[l, h]`` along each axis, ``l
= lo + (hi - lo) (p 2**-k)``, ``h = lo + (hi - lo) ((p + 1) 2**-k)``:

-   *Planes*, of a center ``c`` and half-differences ``g`` (``offset + step * code`` and ``step * code``): slopes
    ``s = g * 2 / (h - l)``, and ``n[0] = c - (s[0] m[0] + s[1] m[1] + ...)`` with ``m = (l + h) / 2 - (ORIGIN +
    LO)``; ``l`` and ``h`` are of the domain as the file has it.
-   *Cones*: the source less ``ORIGIN + LO``, and its offset: ``sqrt`` of the squares of the way to its parent, summed
    axis by axis, added along the parents by doubling (see ``leaves/cone/codec.py``), plus that of the root.
-   *Polynomials*: each value at a corner is the sum, in the order of the free values, of weights times free values
    (see ``leaves/continuous/space.py``); powers of ``t`` are sums of those, in the order of corners, with whole
    numbers as weights.
-   A leaf that nothing reaches continues its neighbor's (mean) plane: see ``plr/_filled.py``.
"""
