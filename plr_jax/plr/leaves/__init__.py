"""Leaf models: what function each leaf holds."""
