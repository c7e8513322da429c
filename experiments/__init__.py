"""One script for each published table and figure; run one as ``python -m experiments.table1``."""
