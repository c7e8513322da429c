"""What a PLR file is made of: a container with the tree, and a stream of bits."""
