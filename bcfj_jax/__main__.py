"""``python -m bcfj_jax``: the command line."""

from __future__ import annotations

from bcfj_jax.cli import main

if __name__ == "__main__":
    main()
