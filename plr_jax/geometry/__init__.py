"""Polygons, visibility and boxes: one truth about the plane for every room."""
