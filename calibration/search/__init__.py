"""From starting points to a minimum of the cost."""
