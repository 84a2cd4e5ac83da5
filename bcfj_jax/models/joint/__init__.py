"""The ball-cage flexible joint: what may be built, its contacts, motion, equilibrium and energy."""
