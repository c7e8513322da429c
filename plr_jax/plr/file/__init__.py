"""PLRs as files: a container, a stream of bits, reading and writing."""
