"""What `VisibilityGraph` knows of whole cells: their free pieces, and the sources that the points of these may use.

A source is the goal or a corner, with its distance to the goal; a point uses it if its shortest path goes straight
there first. `cell_sources` is about one goal, `family_sources` about many goals of one workspace at once, and `sight`
tells both what sources see.
"""
