"""The paper's run beside the model: its claims as data, the model's values for them, a fit to its peaks, the command."""
