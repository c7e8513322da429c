"""Cone leaves: model, file format, search for the best partition, and updates after a change of the map."""
