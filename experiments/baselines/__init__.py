"""Rivals from elsewhere, wrapped so that they solve the same problems as the package."""
