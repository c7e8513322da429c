"""What is proven of PLRs, measured, one section a file: see :mod:`experiments.proofs`.

A section has three functions: ``measure(seed, smoke)`` gives results fit for JSON, ``table(results)`` text, and
``draw(results, output)`` figures, in files whose paths it gives back.
"""
