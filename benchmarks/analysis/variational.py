"""Derivatives of a mechanism's forces by variational equations that SciPy integrates: nothing of ``solve`` is used.

    y' = f(t, y, p),    s' = (df/dy) s + (df/dp) p,    s = p dy/dp,

the right sides by ``jax.jvp`` of the model's field. State and tangents are in the error control. The integration stops
where a contact's penetration passes through its onset, the field's kink, and goes on from there; where the field jumps
there, by f1 - f0, tangents jump by (f0 - f1) dt, dt = -(g_y s + g_p p)/(g_t + g_y f0) the shift of the root of g
(Hiskens and Pai, IEEE Trans. Circuits Syst. I 47 (2000) 204, eq. 34).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

from bcfj_jax.analysis.derivatives.jacobian import Histories
from bcfj_jax.mechanism.model import AbstractModel

# Share of the horizon by which the field is looked at beside a kink, and by which an integration begins after one.
_BESIDE = 1e-10


class Variational:
    """A scene with what is compiled of it: derivatives by the shares of the parameters of ``wrt``."""

    def __init__(self, scene: AbstractModel, wrt: Sequence[str], names: Sequence[str]):
        """``names``: of all parameters that have values."""
        self.scene, self.wrt, self.names = scene, tuple(wrt), tuple(names)
        contacts = [c.name for c in scene.contacts]

        def moved(params: Any, shares: Any) -> Any:
            return {**params, **{n: params[n] * (1.0 + shares[k]) for k, n in enumerate(self.wrt)}}

        def field(t: Any, y: Any, params: Any, shares: Any) -> Any:
            return scene.vector_field(t, y, scene.prepare(moved(params, shares)))

        def seen(t: Any, y: Any, params: Any, shares: Any) -> Any:
            found = [scene.observe(t, y, scene.prepare(moved(params, shares)))[c] for c in contacts]
            force = jnp.concatenate([r.force.reshape(-1, 3) for r in found])
            depth, rate = (jnp.concatenate([getattr(r, k).reshape(-1) for r in found]) for k in ("penetration", "rate"))
            return Histories(force, depth, rate, y)

        def edge(t: Any, y: Any, params: Any, shares: Any) -> Any:
            own = moved(params, shares)
            found = scene.observe(t, y, scene.prepare(own))
            return jnp.concatenate([found[c].penetration.reshape(-1) + own.get("smoothing", 0.0) for c in contacts])

        zero, eye = jnp.zeros(len(self.wrt)), jnp.eye(len(self.wrt))

        def ahead(function: Any, t: Any, y: Any, rows: Any, params: Any) -> Any:
            """Value, and derivatives along the rows (k, n) of tangents and the shares."""
            push = jax.vmap(lambda s, e: jax.jvp(lambda y, q: function(t, y, params, q), (y, zero), (s, e))[1])
            return function(t, y, params, zero), push(rows, eye)

        def whole(t: Any, z: Any, params: Any) -> Any:
            rows = z.reshape(len(self.wrt) + 1, -1)
            value, slopes = ahead(field, t, rows[0], rows[1:], params)
            return jnp.concatenate([value[None], slopes]).reshape(-1)

        def named(values: Any) -> Any:
            return dict(zip(self.names, values, strict=True))

        def start(params: Any) -> Any:
            slopes = jax.jacfwd(lambda q: scene.initial_state(moved(params, q)))(zero)
            return jnp.concatenate([scene.initial_state(params)[None], slopes.T])

        # Parameters as one array, which costs less to hand over.
        self._start = jax.jit(lambda p: start(named(p)))
        self._scales = jax.jit(lambda p, end: scene.error_scale(named(p), end))
        self._whole = jax.jit(lambda t, z, p: whole(t, z, named(p)))
        self._edge = jax.jit(lambda t, y, p: edge(t, y, named(p), zero))
        self._edges = jax.jit(lambda t, y, rows, p: ahead(edge, t, y, rows, named(p)))
        self._seen = jax.jit(jax.vmap(lambda t, y, rows, p: ahead(seen, t, y, rows, named(p)), (0, 0, 0, None)))

    def solve(
        self, params: Mapping[str, Any], times: np.ndarray, rtol: float, method: str = "DOP853", most: int = 2000
    ) -> tuple[Histories, Histories] | None:
        """Histories at times (T,) from 0 and their derivatives by shares (k first); None where it fails.

        Args:
            params, times: as ever.
            rtol: relative tolerance; the absolute one is this of the states' natural sizes.
            method: of ``solve_ivp``.
            most: kinks beyond which it fails.
        """
        p, end = jnp.asarray([float(params[name]) for name in self.names]), float(times[-1])
        rows = np.asarray(self._start(p))
        scales = np.asarray(self._scales(p, end))
        atol = rtol * np.broadcast_to(scales, rows.shape).ravel()
        n, now, z, kinks, gap = rows.shape[1], 0.0, rows.ravel(), 0, _BESIDE * end
        out = np.full((len(times), *rows.shape), np.nan)
        out[times <= 0.0] = rows

        def events(inside: np.ndarray) -> list[Any]:
            def one(k: int) -> Any:
                sign = 1.0 if inside[k] else -1.0

                # Touched at its edge: the side that it goes to counts.
                def passed(t: float, z: np.ndarray) -> float:
                    return sign * float(self._edge(t, z[:n], p)[k])

                passed.terminal, passed.direction = True, -1
                return passed

            return [one(k) for k in range(len(inside))]

        while now < end:
            # Away from the kink that was just met; the square of this step is far below every tolerance.
            begin, z = min(now + gap, end), z + gap * np.asarray(self._whole(now, z, p))
            inside = np.asarray(self._edge(begin, z[:n], p)) > 0.0
            run = solve_ivp(lambda t, z: np.asarray(self._whole(t, z, p)), (begin, end), z, method=method, rtol=rtol,
                            atol=atol, events=events(inside), dense_output=True, max_step=end / 200.0)  # fmt: skip
            if run.status < 0:
                return None
            reached = end if run.status == 0 else float(run.t[-1])
            here = (times > now) & (times <= reached)
            if here.any():
                out[here] = run.sol(times[here]).T.reshape(-1, *rows.shape)
            now, z = reached, run.y[:, -1]
            if run.status == 1:
                kinks += 1
                if kinks > most:
                    return None
                z = self._across(now, z, p, gap, int(np.argmax([len(x) > 0 for x in run.t_events])))
        value, slopes = self._seen(times, out[:, 0], out[:, 1:], p)
        return Histories(*map(np.asarray, value)), Histories(*(np.moveaxis(np.asarray(x), 1, 0) for x in slopes))

    def _across(self, t: float, z: np.ndarray, p: Any, gap: float, contact: int) -> np.ndarray:
        """Tangents after the kink of a contact."""
        rows = z.reshape(len(self.wrt) + 1, -1)
        slope = np.asarray(self._whole(t, z, p))
        before, after = (np.asarray(self._whole(t + h, z + h * slope, p))[: rows.shape[1]] for h in (-gap, gap))
        _, moved = self._edges(t, rows[0], rows[1:], p)
        near = [np.asarray(self._edge(t + h, rows[0] + h * before, p))[contact] for h in (-gap, gap)]
        speed = (near[1] - near[0]) / (2.0 * gap)
        shift = -np.asarray(moved)[:, contact] / speed
        rows = rows.copy()
        rows[1:] += shift[:, None] * (before - after)
        return rows.ravel()
