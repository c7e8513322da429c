"""Environments of other packages, with the true distance in the place of a straight line; ``maze`` is one of our own.

``pip install '.[environments]'`` brings CAMAR, Gymnasium-Robotics, JaxMARL and OGBench. JaxGCRL asks for one version
of JAX, minimax for an old NumPy: they run with today's all the same, installed by ``pip install --no-deps jaxgcrl
minimax-lib`` beside what they import (JaxGCRL: JAX below 0.9, with Brax 0.12).
"""
