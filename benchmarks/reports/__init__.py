"""Looks at the reports in a browser."""
