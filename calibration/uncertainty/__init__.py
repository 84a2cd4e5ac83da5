"""Which interval an estimate gets: covariance, profile likelihood or posterior."""
