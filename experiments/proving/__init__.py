"""What is proven of PLRs, measured: the sections of :mod:`experiments.proofs`."""
