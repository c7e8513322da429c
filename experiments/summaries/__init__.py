"""Rivals of a file that holds all distances of a map: see :mod:`experiments.compare_summaries`.

A rival has ``candidates(given)``: it yields its settings one by one, each with the summary that it makes of so many
bytes. Which of them is the best, pairs tell that it is not given.
"""
