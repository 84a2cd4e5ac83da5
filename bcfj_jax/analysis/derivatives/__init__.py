"""Derivatives of histories and features by parameters, and what they are worth."""
