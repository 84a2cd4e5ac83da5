"""From parameters to predicted readings and their residuals."""
