"""Proofs: how far the distance can be from what leaves hold, everywhere in them."""
