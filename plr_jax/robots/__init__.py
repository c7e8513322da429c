"""Robots: what a body is to the rest of the library, its motions (`robot`), and the shapes there are (`shapes`)."""
