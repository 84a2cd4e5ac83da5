"""Tests of a fit: influence, agreement, residuals, location of misfit."""
