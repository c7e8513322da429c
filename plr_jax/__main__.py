"""Run the command ``plr-jax`` as ``python -m plr_jax``."""

from plr_jax.cli import main

if __name__ == "__main__":
    main()
