"""Design by gradient: free parameters within bounds, a feature made least (or most), tolerances and a check.

The verb is ``api.design``, public as ``bcfj_jax.design``. Reading order: ``space`` (what is free), ``objective`` (what
is made least), ``evaluate`` (both in one compiled batch), ``descent`` and ``refine`` (to the optimum), ``tolerance``
(what manufacture makes of it), ``confirm`` (a run that knows nothing of all that), ``result``.
"""
