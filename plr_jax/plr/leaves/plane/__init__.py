"""A plane in every leaf, the paper's model."""
