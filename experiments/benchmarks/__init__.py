"""The sections of ``python -m experiments.benchmark``, one a file.

A section has ``measure(seed, smoke)``, which gives results fit for JSON; some have ``draw(results, output)``, which
writes figures into a folder and returns their paths. Contenders of
a section run in one process, on the same points, taking turns (:mod:`experiments.benchmarks._timing`); a contender
that is not installed is named in the results under ``"skipped"``, with what to install.
"""
