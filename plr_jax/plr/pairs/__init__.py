"""Distances between any two points of a planar workspace: the corners at which paths from each cell may turn first.

Building: `visible_corners` finds these corners cell by cell, `growth` halves cells, `lattice` rounds free space to
the `outline` that a file keeps, and `construct` puts it together. Storing: `stored` is what a file holds, `joined`
what follows from its outline where it was cut off. Asking: a `query` reads `tables` and `near_walls`; `pair_plr` is
the face, and `one_goal` takes out the PLR of one goal.
"""
