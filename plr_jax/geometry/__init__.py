"""Geometry: boxes, workspaces, boundaries, triangulation, visibility, paths, pixels and voxels."""
