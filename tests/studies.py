"""Studies that tests share."""

from __future__ import annotations

STUDY = """
scene = "impact"
[design]
kind = "grid"
[vary.stiffness]
lower = 1e6
upper = 1e8
steps = 7
scale = "log"
[vary.damping]
values = [0.0, 0.1]
[results]
features = ["contact.peak", "contact.impulse", "contact.contact_fraction"]
"""
