"""Studies: one scene at many points of its parameters, in batches, on disk before the next begins.

``specification`` says which points, ``design`` where they are, ``batch`` computes many at once, ``block`` makes a
table of a block of them, ``store`` keeps it, ``local`` and ``cluster`` have many workers at it, ``command`` is the
outside, ``pages`` what it says. Of a study that is ``finished``, ``sensitivity`` says what matters and ``surface``, by
``kriging``, what lies between its points.
"""
