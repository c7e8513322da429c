"""Room 1, discover: distance functions computed from an obstacle map or a roadmap."""
