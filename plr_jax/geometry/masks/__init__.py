"""Grids of free and blocked pixels: their outlines, traced exactly, simplified, and put together as polygons."""
