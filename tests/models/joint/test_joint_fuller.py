"""The joint with rolling balls, window ends and bands as its users have it: fidelities, range, the command."""

from __future__ import annotations

import json
import tomllib

import numpy as np
import pytest
from commands import bcfj
from conftest import BUILD
from joints import plain_joint

import bcfj_jax as bj
from bcfj_jax.models.joint.scene import PLAIN

FULLER = dict.fromkeys(PLAIN, True)
SCENE = plain_joint(**FULLER)


@pytest.mark.slow
def test_a_slow_joint_settles_onto_the_quasistatic_one():
    """Driven at a tenth of the default speed, without friction, well damped, loaded over 0.2 s."""
    times = np.linspace(0.0, 0.4, 201)
    settled, runs = times > 0.25, []
    for fidelity in ("dynamic", "quasistatic"):
        scene = plain_joint(**FULLER, friction=False, fidelity=fidelity)
        runs.append(bj.simulate(scene, scene.parameters(drive_speed=1.0, damping=10.0, load_ramp=0.2), times))
        assert runs[-1].status == "ok", runs[-1].reason
    moving, still = runs
    assert not np.any(still.force["cage_window_end"]) and not np.any(moving.force["cage_window_end"][settled])
    for name, force in still.force.items():
        off = np.abs(moving.force[name][settled] - force[settled])
        assert off.max() <= 0.01 * np.abs(force).max(), name


@pytest.mark.slow
@pytest.mark.parametrize("angle", [8.0, 30.0])
def test_auto_keeps_a_percent_of_every_contact(angle):
    params = {"joint_angle": np.radians(angle)}
    times = np.linspace(1.9, 2.5, 121)
    scenes = [plain_joint(**FULLER, fidelity=fidelity) for fidelity in ("auto", "dynamic")]
    found, truth = (bj.simulate(scene, scene.parameters(params), times) for scene in scenes)
    for name, force in truth.force.items():
        off = np.sqrt(np.mean((found.force[name] - force)[..., 0] ** 2, axis=0)).max()
        assert off <= 0.01 * np.abs(force).max(), (name, found.choice)


@pytest.mark.slow
def test_a_scene_file_runs_and_states_what_it_was(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("BCFJ_CACHE", str(BUILD / "jax-cache"))
    lines = "".join(f"{name} = true\n" for name in FULLER)
    (tmp_path / "s.toml").write_text(f'[scene]\nkind = "joint"\n{lines}[time]\nend = "0.2 s"\n', encoding="utf-8")
    done = bcfj("simulate", "s.toml", "--out", "out")
    assert done.exit_code == 0, done.output
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert {"pilot_band", "clearance_cage_window_end"} <= set(
        tomllib.loads((tmp_path / "out" / "run.toml").read_text())["parameters"]
    )
    assert "cage_window_end" in json.dumps(summary["engineering"])


def test_window_ends_hold_over_the_range_of_deflections():
    for angle in (0.0, 23.0, 50.0, 59.6):
        SCENE.check(SCENE.parameters(joint_angle=float(np.radians(angle))))
    # The plainest fault is told: the head's shaft before the windows.
    with pytest.raises(bj.InputError, match=r"into the seat.*at most"):
        SCENE.check(SCENE.parameters(joint_angle=float(np.radians(75.0))))
