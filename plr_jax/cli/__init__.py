"""The command ``plr-jax``: build, query, inspect and draw piecewise linear regressions."""

from plr_jax.cli._commands import app as app
from plr_jax.cli._commands import main as main
