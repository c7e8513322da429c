"""Where cells are sampled, what a distance function answers there, and its planes, which split rules judge."""
