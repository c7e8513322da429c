"""Robots: convex bodies, their configurations, and straight motions between configurations (`robot`)."""
