"""Values at the corners of leaves, tied across free faces: nothing jumps where one can walk."""
