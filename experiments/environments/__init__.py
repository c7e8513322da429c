"""Environments of other packages, with the true distance in the place of a straight line; ``maze`` is one of our own.

``pip install '.[environments]'`` brings CAMAR, Gymnasium-Robotics, JaxMARL and OGBench; ``'.[pedestrians]'`` brings
JuPedSim. JaxGCRL asks for jax==0.4.25, minimax for numpy<1.26: both run with what plr-jax asks for if ``pip install
--no-deps jaxgcrl minimax-lib`` puts them beside what they import. JaxGCRL was run with JAX 0.8 and Brax 0.12.
"""
