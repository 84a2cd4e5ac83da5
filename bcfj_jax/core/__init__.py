"""What everything else stands on: errors, status codes, safe arithmetic, quantities, progress."""
