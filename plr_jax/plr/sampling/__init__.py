"""Where cells are sampled, and what a distance function answers there."""
