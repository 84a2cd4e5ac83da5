"""The command line in the process of a test."""

from __future__ import annotations

from typing import Any

from typer.testing import CliRunner

from bcfj_jax.cli import app


def bcfj(*arguments: object, **options: Any):
    """What ``bcfj`` gives with these words: exit code and output."""
    return CliRunner().invoke(app, [str(a) for a in arguments], **options)
