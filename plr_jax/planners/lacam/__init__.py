"""Search for large teams: one step of the whole team at a time, under constraints that grow as they are needed."""
