"""PLRs of many goals of one workspace at once: a cell that is alike for several goals is looked at once for all.

`task` is the face. All goals start at the boxes of `start`, below which `levels` has every distinct box and its
halves. `members` seeks, for each goal, the price of a leaf at which the best tree fills its bytes; `trees` walks
these trees; and `in_sight` exchanges sources of their leaves for others that the leaves see.
"""
