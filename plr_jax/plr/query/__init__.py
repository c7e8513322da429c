"""From a point to its leaf by arithmetic, and to a value."""
