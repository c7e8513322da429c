"""The command ``plr-jax``: build, query, inspect and draw piecewise linear regressions, and plan with them."""

# Importing the commands registers them; the help lists them in this order.
from plr_jax.cli import _commands as _commands
from plr_jax.cli import _plan as _plan
from plr_jax.cli._app import app as app
from plr_jax.cli._app import main as main
