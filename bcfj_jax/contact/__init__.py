"""What two surfaces do to each other: gaps, normal-force laws, friction, stiffness, restitution."""
