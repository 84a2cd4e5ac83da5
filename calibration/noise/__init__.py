"""The size and the memory of the noise, stated or estimated."""
