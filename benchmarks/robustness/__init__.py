"""What breaks: mutated files, attacks on the Python interface, kills, races, hostile surroundings."""
