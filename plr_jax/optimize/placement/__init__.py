"""Facility location by the gradients of distances between points: medians and centers in free space.

`driver` is the face: `arguments` are checked, `seeding` chooses starts, descent follows the gradients of soft `costs`
by `moves` in free space, and `settling` finishes without gradients.
"""
