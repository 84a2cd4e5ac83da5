"""Low-passes between a sensor and its record: Butterworth and Bessel, order 1 to 8, causal or run forwards and backwards.

A filter of order N with the cut-off f (its 3 dB frequency, of one pass) has poles p_k w, w = 2 pi f, all of them simple.
By partial fractions its output is a sum of outputs of the first order,

    y = Re sum c_k u_k,    u_k' = r_k w (x - u_k),    r_k = -p_k,

one of each pair of conjugate poles. Run forwards and backwards it shifts no phase, and its gain is squared.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bcfj_jax import InputError, nearest
from bcfj_jax.core.quantities import whole

KINDS, HIGHEST = ("butterworth", "bessel"), 8
# Terms of the highest order: poles that are not the conjugate of one before.
TERMS = HIGHEST // 2


class Filter(NamedTuple):
    """A low-pass of one kind ("butterworth" or "bessel") and order (1 to 8); ``zero_phase``: run forwards and backwards."""

    kind: str = "butterworth"
    order: int = 2
    zero_phase: bool = False

    def checked(self, where: str) -> Filter:
        """Itself.

        Raises:
            InputError: for a kind or an order that there is not.
        """
        if self.kind not in KINDS:
            raise InputError(f"{where} kind", f"no filter '{self.kind}'", nearest(str(self.kind), KINDS))
        if whole(f"{where} order", self.order, least=1) > HIGHEST:
            raise InputError(f"{where} order", f"{self.order}", f"give an order from 1 to {HIGHEST}")
        return self

    @property
    def terms(self) -> tuple[np.ndarray, np.ndarray]:
        """Rates r_k and weights c_k (TERMS,) of the partial fractions; weight 0 where there is none."""
        poles = self._poles()
        others = poles[:, None] - poles + np.eye(poles.size)
        # Residues of H(s) = prod(-p)/prod(s - p), over -p_k.
        weights = np.prod(-poles) / np.prod(others, axis=1) / -poles
        upper = np.imag(poles) > -1e-9
        rates, kept = -poles[upper], weights[upper] * np.where(np.imag(poles[upper]) > 1e-9, 2.0, 1.0)
        filled = np.ones(TERMS, dtype=complex), np.zeros(TERMS, dtype=complex)
        filled[0][: rates.size], filled[1][: rates.size] = rates, kept
        return filled

    @property
    def delay(self) -> float:
        """How late slow signals come out, times the cut-off: [s Hz]; 0 without a phase."""
        return 0.0 if self.zero_phase else float(np.sum(-1.0 / self._poles()).real) / (2.0 * np.pi)

    def _poles(self) -> np.ndarray:
        """Of the cut-off 1 rad/s."""
        from scipy.signal import besselap, buttap

        # The analogue prototypes: zeros, poles, gain.
        found = besselap(self.order, norm="mag") if self.kind == "bessel" else buttap(self.order)
        return np.array(found[1], dtype=complex)

    def __str__(self) -> str:
        name = "Bessel" if self.kind == "bessel" else "Butterworth"
        return f"{name} low-pass of order {self.order}" + (" run forwards and backwards" if self.zero_phase else "")
