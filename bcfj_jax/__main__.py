"""``python -m bcfj_jax``: the command line."""

from __future__ import annotations

from bcfj_jax.cli import command

if __name__ == "__main__":
    command()
