"""The paper's run beside the model: claims as data, the model's values for them, a fit to the peaks, the command."""
