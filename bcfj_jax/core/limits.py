"""Most of what a verb or a file may ask for; more is a slip of the hand, and is refused before memory is taken."""

from __future__ import annotations

# Points from which an optimisation or a fit starts: all of them descend in one batch.
STARTS = 1000
# Iterations of a search, and runs of a Monte Carlo.
RUNS = 100_000
# Like bodies side by side, tracks of a race, windows of a cage.
MEMBERS = 1000
# Times of a run that a file or a scene asks for.
SAMPLES = 10_000_000
