"""Work around JAX and XLA: what each module buys, and what would let us delete it, is in ``docs/xla.md``."""
