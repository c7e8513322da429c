"""The shapes that move, a shape a file, and motions between their configurations."""
