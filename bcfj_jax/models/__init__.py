"""The built-in scenes: short functions that return a mechanism."""
