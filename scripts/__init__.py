"""Scripts about the package as a whole: distributions, interpreters, releases, a first run. Standard library only."""
