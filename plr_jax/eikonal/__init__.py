"""Distance functions straight from what is free and what a step costs: the eikonal equation on a partition."""
