"""Facility location by the gradients of distances between points: medians and centers in free space.

`place` is the face: it checks arguments and descends by the gradients of soft `costs`; `search` chooses starts, steps
in free space, and finishes without gradients.
"""
