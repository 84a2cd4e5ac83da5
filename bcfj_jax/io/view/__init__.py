"""A run as a picture that moves: the interactive figure of a report, glTF, and movies."""
