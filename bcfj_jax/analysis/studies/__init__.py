"""Studies: one scene at many points of its parameters, in batches, on disk before the next begins.

``specification`` says which points and where they are, ``batch`` computes many at once, ``block`` makes a
table of a block of them, ``store`` keeps it, ``worker`` and ``cluster`` have many at it, ``command`` is the
outside. Of a study that is finished, ``sensitivity`` says what matters and ``surface`` what lies between its points.
"""
