"""Fitting a PLR's planes again, all at once, to a loss."""
