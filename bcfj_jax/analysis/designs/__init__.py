"""Design by gradient: free parameters within bounds, a feature made least (or most), tolerances and a check.

The verb is ``api.design``. Reading order: ``space`` (what is free, and how it is sought), ``objective`` (what is made least),
``evaluate`` (both in one compiled batch), ``descent``, ``refine``, ``confirm`` (what the optimum is worth), ``result``.
"""
