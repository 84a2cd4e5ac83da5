"""What is asked of runs: features, sensitivities, studies, designs, trade-offs, nonlinear dynamics."""
