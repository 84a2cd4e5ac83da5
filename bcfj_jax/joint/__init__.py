"""The ball-cage flexible joint: its geometry, what may be built, its statics."""
