"""PLRs of many goals of one workspace at once: a cell that is alike for several goals is looked at once for all.

`members` is the face: all goals start at the boxes of `start`, below which levels of boxes grow as those of one goal
do (`growth/levels.py`), and for each the price of a leaf is sought at which the best tree fills its bytes. `trees`
walks these trees.
"""
