"""Room 2, store: piecewise linear regressions over a binary space partition."""
