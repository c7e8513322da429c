"""Named scenes, the scene file format, and readers of public map formats."""
