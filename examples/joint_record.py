"""Makes joint_record.csv: normal forces of all contacts of a joint in equilibrium over one revolution, with 1 % noise.

python examples/joint_record.py    a stand-in for a measurement; joint_fit.toml finds the coefficients again
"""

from pathlib import Path

import numpy as np

import bcfj_jax as bj

scene = bj.scenes.joint(fidelity="quasistatic")
times = np.linspace(0.06, 0.66, 41)
run = bj.simulate(scene, scene.parameters(), times)
draw = np.random.default_rng(0)

columns = {"time [s]": times}
for contact, force in run.force.items():
    normal = force[..., 0].reshape(times.size, -1)
    names = [f"{contact}_{i + 1}" for i in range(normal.shape[1])] if force.ndim == 3 else [contact]
    for name, values in zip(names, normal.T, strict=True):
        columns[f"{name} [N]"] = values + 0.01 * np.abs(values).max() * draw.standard_normal(times.size)

path = Path(__file__).parent / "joint_record.csv"
rows = [",".join(columns), *(",".join(f"{v:.6g}" for v in row) for row in zip(*columns.values(), strict=True))]
path.write_text("\n".join(rows) + "\n", encoding="utf-8")
