"""Scene and table files, units, results, reports, provenance."""
