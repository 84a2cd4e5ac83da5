"""Choice among models and of the next experiment."""
