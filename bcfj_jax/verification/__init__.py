"""``bcfj verify``: published numbers and closed forms beside what this installation computes."""
