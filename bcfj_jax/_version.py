"""The version of bcfj-jax: the one place that says it; the build, the command line and every report read it here."""

__version__ = "0.2.0"
