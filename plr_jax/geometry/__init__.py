"""Geometry: boxes, workspaces, boundaries, triangulation, visibility, sources of cells, pixels and voxels."""
