"""Time of a query (stub to be filled)."""
