"""Where cells are sampled, what a distance function answers there, and planes that fit it, which split rules judge."""
