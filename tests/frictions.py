"""Coefficients and sliding velocities that the tests of friction share."""

from __future__ import annotations

from hypothesis import strategies as st

# The coefficients of the joint's paper at the ADAMS default speed of 100 mm/s; bristles of a steel contact.
C = {
    "friction_static": 0.12, "friction_dynamic": 0.03, "friction_speed": 0.1,
    "bristle_stiffness": 1e5, "bristle_damping": 30.0, "friction_memory": 5e-3,
    "friction_viscous": 0.0,
}  # fmt: skip
# Components of a sliding velocity [m/s], at rest and near it, where derivatives break, and beyond all use.
COMPONENT = st.floats(-1e6, 1e6, allow_subnormal=True) | st.sampled_from([0.0, 1e-300, -1e-300, 1e6, 1e-8, 0.1, 1.0])
