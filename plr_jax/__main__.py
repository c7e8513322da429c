"""``python -m plr_jax``: the command ``plr-jax``."""

from plr_jax.cli import main

if __name__ == "__main__":
    main()
