"""Storing less: a part of a domain of which symmetries make the rest, and what a closed form leaves of a distance."""
