"""Several PLRs of one domain, coarser and finer: in one file, and one made of another."""
