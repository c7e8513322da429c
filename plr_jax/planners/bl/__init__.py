"""The Barraquand-Latombe planner for several robots: best-first search on lattices of configurations."""
