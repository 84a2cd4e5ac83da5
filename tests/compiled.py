"""What this process has compiled, for tests of what must be refused before anything is."""

from __future__ import annotations

import jax

# One event a program, from the compile cache or not; clear it before what is watched.
COMPILED: list[str] = []
jax.monitoring.register_event_duration_secs_listener(
    lambda event, _, **__: COMPILED.append(event) if "backend_compile" in event else None
)
