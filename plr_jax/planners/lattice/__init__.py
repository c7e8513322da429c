"""The lattices on which planners search: configurations of robots, and motions between them."""
