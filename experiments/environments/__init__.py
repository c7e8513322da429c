"""Environments of other packages, with the true distance in the place of a straight line."""
