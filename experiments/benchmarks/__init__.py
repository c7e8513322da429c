"""The sections of ``python -m experiments.benchmark``, one a file.

A section has ``measure(seed, smoke)``, which gives results fit for JSON; ``table(results)``, the results as text that
lines up; and ``draw(results, output)``, which writes its figures into a folder and returns their paths. Contenders of
a section run in one process, on the same points, taking turns (:mod:`experiments.benchmarks._timing`); a contender
that is not installed is named in the results under ``"skipped"``, with what to install.
"""
