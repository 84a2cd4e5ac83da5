"""Motion capture of a tossed body: the first state, the scene and the problem file of a record of places and attitudes."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import equinox as eqx
import numpy as np
import openpyxl
import pytest
from scipy.spatial.transform import Rotation

import bcfj_jax as bj
from bcfj_jax import InputError
from bcfj_jax.data.reading import read
from calibration import command, fit, init, load
from calibration.diagnostics.records import series_of
from calibration.forward.model import Model, build
from calibration.forward.runs import Contact
from calibration.impacts import otherwise, tosses
from calibration.impacts.otherwise import InMotion
from calibration.noise.noise_model import Estimate
from calibration.search import continuation
from calibration.search.descent import Descents
from calibration.search.horizon import stages
from calibration.search.starts import Screen, search
from calibration.solver_budget import budget
from calibration.uncertainty.estimates import Parameter

HALF, MASS, FRICTION, STIFFNESS, DAMPING = 0.05, 0.4, 0.25, 2e4, 3.0
START = dict(x=0.1, y=-0.2, z=0.16, vx=-0.9, vy=0.5, vz=0.2, wx=3.0, wy=-2.0, wz=1.0, q0=0.8, q1=0.3, q2=-0.4, q3=0.33)
TIMES = np.arange(0.0, 0.9, 1.0 / 150.0)
NAMES = [f"body.place.{a}" for a in "xyz"] + [f"body.attitude.q{k}" for k in range(4)]
PLACE_NOISE, TURN_NOISE = 2e-4, 2e-3


def toss(seed=0, up="z", **start):
    """Clock, places (3, N), attitudes (4, N) of a cube by the simulator, with the noise of motion capture."""
    scene = bj.Mechanism(
        "toss",
        [bj.Body("body", joint="free", start={**START, **start})],
        [bj.Contact("corner", ("ground", "body"), bj.gaps.BoxOnPlane(up), friction="coulomb")],
        [bj.loads.Gravity(f"-{up}")],
        given=dict(mass=MASS, inertia=2 / 3 * MASS * HALF**2, stiffness=STIFFNESS, exponent=1.0, damping=DAMPING,
                   half_length=HALF, half_width=HALF, half_height=HALF, friction_dynamic=FRICTION, friction_speed=0.02),
    )  # fmt: skip
    found = bj.reading_history(scene, scene.parameters(), TIMES, NAMES)
    rng = np.random.default_rng(seed)
    places = np.array([found[n] for n in NAMES[:3]]) + PLACE_NOISE * rng.standard_normal((3, TIMES.size))
    turned = Rotation.from_rotvec(TURN_NOISE * rng.standard_normal((TIMES.size, 3)))
    turned = turned * Rotation.from_quat(np.array([found[n] for n in NAMES[3:]]).T, scalar_first=True)
    return places, turned.as_quat(scalar_first=True).T


def write(path, places, attitudes, names=("x [m]", "y [m]", "z [m]", "q0", "q1", "q2", "q3"), time=TIMES):
    rows = [",".join(f"{v:.7g}" for v in row) for row in zip(time, *places, *attitudes, strict=True)]
    path.write_text("\n".join([",".join(["time [s]", *names]), *rows]) + "\n")
    return path


@pytest.mark.slow
def test_the_first_state_is_within_its_bounds_whatever_the_signs():
    truth = {**START}
    length = np.linalg.norm([truth[f"q{k}"] for k in range(4)])
    for seed in range(5):
        places, attitudes = toss(seed)
        signs = np.random.default_rng(seed).choice([-1.0, 1.0], TIMES.size)
        found = tosses.first(TIMES, places, attitudes * signs, 2)
        turned = np.sign(found.values["q0"])
        for name, value in truth.items():
            wanted = turned * value / length if name[0] == "q" else value
            assert abs(found.values[name] - wanted) < found.halves[name], (seed, name)


@pytest.mark.slow
def test_a_record_of_a_toss_becomes_a_box_on_a_plane(tmp_path):
    said = []
    path = write(tmp_path / "toss.csv", *toss())
    init.run(path, tmp_path / "toss.toml", init.Said(mass="0.4 kg"), said.append)
    assert any("CHECK its size and inertia" in line for line in said)
    problem = load(tmp_path / "toss.toml")
    names = {f.name for f in problem.free}
    # The largest component of the attitude is held: the length of a quaternion says nothing.
    assert names == {"stiffness", "damping", "friction_dynamic", "inertia", *(f"body.{n}" for n in START if n != "q0")}
    assert all(f.each for f in problem.free if f.name.startswith("body."))
    assert problem.params["half_height"] == pytest.approx(HALF, rel=0.02)
    for name, value in START.items():
        bounds = problem.experiments[0].bounds.get(f"body.{name}")
        if bounds and name[0] != "q":
            assert bounds[0] < value < bounds[1], name


def test_a_miss_in_contact_is_a_share_of_the_peak_whatever_the_flight_weighs(tmp_path):
    init.run(write(tmp_path / "toss.csv", *toss()), tmp_path / "toss.toml", init.Said(mass="0.4 kg"), lambda line: None)
    problem = load(tmp_path / "toss.toml")
    model = build(problem, problem.fitted)
    weights = np.array(model.data.weights)
    weights[..., :20] *= 30.0
    weighed = eqx.tree_at(lambda m: m.data.weights, model, weights)
    seen = [Contact(0, "corner", 0.0, TIMES, np.arange(TIMES.size) >= 20, True)]
    none = np.zeros(weights.size)

    def shares(of: Model) -> list[float]:
        known = dict(noise=Estimate({}, {}, []), end=SimpleNamespace(residuals=none), experiments=problem.fitted)
        return [s.share for s in series_of(cast(Any, SimpleNamespace(model=of, **known)), seen, none, 1e-4)]

    assert shares(weighed) == shares(model) and min(shares(model)) > 0.0


def test_many_tosses_have_a_first_state_each_and_other_words_for_columns(tmp_path):
    for k in range(2):
        places, attitudes = toss(k, x=0.1 * k)
        write(
            tmp_path / f"run{k}.csv",
            1e3 * places,
            attitudes,
            ("pos_x [mm]", "pos_y [mm]", "pos_z [mm]", "qw", "qx", "qy", "qz"),
        )
    init.run(tmp_path / "run*.csv", tmp_path / "all.toml", init.Said(), lambda line: None)
    one, two = load(tmp_path / "all.toml").experiments
    assert one.bounds["body.x"][1] < 0.05 < two.bounds["body.x"][0]
    assert "stiffness is for a mass of 1 kg" in (tmp_path / "all_scene.toml").read_text()


@pytest.mark.parametrize("names", ["px [mm],py [mm],pz [mm]", "TX [mm],TY [mm],TZ [mm]"])
def test_sheets_of_tosses_are_runs_and_a_sheet_beside_them_states_the_mass(names, tmp_path):
    book = openpyxl.Workbook()
    book.worksheets[0].append(["Mass [g]", 400])
    for k in range(2):
        places, attitudes = toss(k, x=0.1 * k)
        sheet = book.create_sheet(f"Toss {k + 1}")
        sheet.append(["time [s]", *names.split(","), "qw", "qx", "qy", "qz"])
        for row in zip(TIMES, *(1e3 * places), *attitudes, strict=True):
            sheet.append([float(x) for x in row])
    book.save(tmp_path / "tosses.xlsx")
    init.run(tmp_path / "tosses.xlsx", tmp_path / "all.toml", init.Said(), lambda line: None)
    found = load(tmp_path / "all.toml")
    one, two = found.experiments
    assert one.bounds["body.x"][1] < 0.05 < two.bounds["body.x"][0] and found.params["mass"] == 0.4


def test_what_is_no_flight_and_what_is_an_impact_all_the_same(tmp_path):
    places, attitudes = toss()
    rests = write(tmp_path / "rests.csv", places[:, -60:], attitudes[:, -60:], time=TIMES[:60])
    with pytest.raises(InputError, match="its first rows fall along no axis"):
        init.run(rests, tmp_path, init.Said(), lambda line: None)
    with pytest.raises(InputError, match="places and attitudes of a body in motion"):
        init.run(rests, tmp_path, init.Said("impact"), lambda line: None)
    assert not list(tmp_path.glob("*.toml"))


def test_a_tumbling_record_is_fitted_from_its_beginning_on_and_many_of_them_sparingly(tmp_path):
    init.run(write(tmp_path / "toss.csv", *toss()), tmp_path / "toss.toml", init.Said(mass="0.4 kg"), lambda line: None)
    problem = load(tmp_path / "toss.toml")
    ends = stages(build(problem, problem.experiments))
    np.testing.assert_allclose(np.concatenate(ends) / TIMES[-1], [0.25, 0.5, 1.0], rtol=1e-6)
    (one,) = problem.experiments
    many = replace(problem, experiments=tuple(replace(one, name=f"toss {k}") for k in range(8)))
    assert (problem.unknowns, many.unknowns) == (16, 100)
    # An evaluation of all takes a second: both cores, few points, and no walk along every first state.
    assert (budget(problem).apart, budget(problem).bends) == (False, True)
    assert (budget(many).apart, budget(many).bends) == (True, False)
    # What eight tosses of a cube ask for is explicit: friction that barely is no stiff one.
    assert not problem.scene.traits.stiff
    held = replace(one, name="held out", hold_out=True)
    first, last = replace(problem, experiments=(one, held)).until([0.3]).experiments
    assert (
        first.times.size == first.channels[0].values.size == np.count_nonzero(one.times <= 0.3)
        and last.times.size == one.times.size
    )


@pytest.mark.parametrize(
    ("shares", "followed"), [((1.0, 2.9), None), ((1.0, 3.1), 0.25), ((0.01, 0.29), None), ((0.01, 0.31), 0.25)]
)
def test_a_tumbling_body_is_followed_while_a_sample_costs_no_more_than_three_times(shares, followed, monkeypatch):
    ends = [np.array([end]) for end in (0.25, 0.5, 1.0)]
    costs = {0.25: shares[0], 0.5: shares[1], 1.0: shares[1]}

    def part(_, end=ends[-1]):
        return SimpleNamespace(
            end=float(end[0]), data=SimpleNamespace(weights=np.ones(round(100 * end[0]))), scene=scene
        )

    def descend(model, block, leg, before):
        each = costs[model.end] * model.data.weights.size
        return Descents(block, np.full(len(block), each), np.ones(len(block), dtype=bool))

    scene, seams = SimpleNamespace(traits=SimpleNamespace(turning=False)), {
        "stages": lambda model: ends, "until": part, "loosened": lambda model: model, "tumbles": lambda model: True,
        "budget": lambda model: SimpleNamespace(apart=False, kept=8), "_descend": descend,
        "evaluator": lambda model: lambda points: (points, None), "meets": lambda model, r, ends: np.zeros((len(r), 3), bool),
    }  # fmt: skip
    for name, stand_in in seams.items():
        monkeypatch.setattr(continuation, name, stand_in)
    found = continuation.continued(cast(Any, part(None)), np.full((4, 2), 0.5), 4)
    assert (None if found.followed is None else float(found.followed[0])) == followed
    if followed:
        np.testing.assert_allclose((*found.shares, *found.found.costs), [*shares, *[25 * shares[0]] * 4])


def test_many_first_states_are_shown_by_their_range():
    runs = {f"body.x[toss_{k}]": Parameter(0.1 + 0.01 * k, "m", None, True, "") for k in range(25)}
    shown = {"damping": Parameter(4.0, "s/m", None, True, ""), **runs}
    assert command._own(shown) == (["damping"], [["body.x of 25 runs", "100 to 340 mm"]])
    runs.popitem(), shown.popitem()
    assert command._own(shown) == (["damping", *runs], [])


def test_a_body_that_is_held_at_first_falls_later_and_a_matrix_is_an_attitude(tmp_path):
    """As Qualisys writes it: millimetres that no line states, the matrix column by column, zeros of a body that is not seen."""
    held, begins = 30, 30 / 150.0
    clock = begins + np.arange(40) / 150.0
    fall = 0.4 - 0.5 * 9.81 * (clock - begins) ** 2
    places = np.array([0.1 + 0.3 * (clock - begins), 0.0 * clock, fall])
    turned = Rotation.from_rotvec(np.outer(np.arange(40) / 150.0, [0.3, -2.0, 1.0]))
    places = np.c_[np.repeat(places[:, :1], held, axis=1), places] + 1e-5 * np.sin(1e3 * np.arange(70))
    matrices = np.r_[np.repeat(np.eye(3)[None], held, axis=0), turned.as_matrix()]
    cells = np.c_[1e3 * places.T, matrices.transpose(0, 2, 1).reshape(-1, 9)]
    cells[50, 3:] = 0.0
    names = ["X", "Y", "Z", *(f"Rot[{k}]" for k in range(9))]
    rows = ["\t".join(f"{v:.6f}" for v in row) for row in cells]
    (tmp_path / "box.tsv").write_text("\n".join(["FREQUENCY\t150", "\t".join(names), *rows]) + "\n")
    init.run(tmp_path / "box.tsv", tmp_path / "box.toml", init.Said(mass="0.4 kg"), lambda line: None)
    scene = tmp_path / "box_scene.toml"
    scene.write_text(scene.read_text().replace("? kg m^2", "1e-3 kg m^2").replace("? mm", "50 mm"))
    (one,) = load(tmp_path / "box.toml").experiments
    assert one.times[0] == pytest.approx(one.fixed["time_offset"]) == pytest.approx(begins, abs=4.1 / 150.0)
    seen = {c.observes: c.values for c in one.channels}
    shown = np.round(one.times * 150).astype(int)
    np.testing.assert_allclose(seen["body.place.z"], places[2, shown], atol=1e-5)
    wanted = Rotation.from_matrix(matrices[shown]).as_quat(scalar_first=True)
    whole = shown != 50
    for k in (1, 2, 3):
        np.testing.assert_allclose(seen[f"body.attitude.q{k}"][whole], wanted[whole, k], atol=2e-6)
    assert np.isnan(seen["body.attitude.q1"][~whole]).all()


@pytest.mark.parametrize(
    ("order", "said", "names"),
    [
        ("XYZ", "turn about the body's x, y, z", ["Roll", "Pitch", "Yaw"]),
        ("ZYX", "turn about the body's z, y, x", ["Roll", "Pitch", "Yaw"]),
        ("vector", "are a rotation vector", ["RX [deg]", "RY [deg]", "RZ [deg]"]),  # Vicon's helical angles.
    ],
)
def test_angles_are_an_attitude_in_the_order_in_which_nothing_turns_a_body_in_flight(order, said, names, tmp_path):
    """Roll, pitch and yaw of a spin that stays; of one about a single axis either order fits, and a ball is not taken for it."""
    clock = np.arange(120) / 200.0
    turned = Rotation.from_rotvec([0.2, 0.1, -0.3]) * Rotation.from_rotvec(np.outer(clock, [5.0, -4.0, 3.0]))
    if order == "vector":
        angles = turned.as_rotvec(degrees=True)
    else:
        angles = turned.as_euler(order, degrees=True) @ (np.eye(3) if order == "XYZ" else np.eye(3)[::-1])
    places = np.array([0.3 * clock, 0.1 * clock, 1.9 - 0.5 * 9.81 * clock**2])
    shared = ["time [s]", *(f"pose.position.{k} [m]" for k in "xyz")]

    def write_it(name, cells, more):
        rows = "".join(",".join(f"{v:.6f}" for v in row) + "\n" for row in cells)
        (tmp_path / name).write_text(",".join([*shared, *more]) + "\n" + rows)

    write_it("box.csv", np.c_[clock, places.T, angles], names)
    table = read(tmp_path / "box.csv", "record")
    found = np.array([table.numbers(f"q{k}", "1", "box", True) for k in range(4)])
    np.testing.assert_allclose(np.abs(np.sum(found.T * turned.as_quat(scalar_first=True), axis=1)), 1.0, atol=1e-9)
    assert f"angles {said}: its spin" in table.found
    with pytest.raises(InMotion):
        otherwise.refuse_motion(table)
    about = np.c_[clock, places.T, 0.0 * clock, 0.0 * clock, 400.0 * clock]
    write_it("top.csv", about, ["Roll [deg]", "Pitch [deg]", "Yaw [deg]"])
    with pytest.raises(InputError, match=r"write its attitude as columns q0 to q3"):
        otherwise.refuse_motion(read(tmp_path / "top.csv", "record"))
    write_it("ros.csv", np.c_[clock, places.T, found.T], [f"pose.orientation.{k}" for k in "wxyz"])
    with pytest.raises(InMotion) as moved:
        otherwise.refuse_motion(read(tmp_path / "ros.csv", "record"))
    assert moved.value.columns["q3"] == "pose.orientation.z" and moved.value.columns["x"] == "pose.position.x [m]"


@pytest.mark.slow
def test_friction_of_a_toss_is_found_with_its_first_state_free(tmp_path):
    init.run(write(tmp_path / "toss.csv", *toss()), tmp_path / "toss.toml", init.Said(mass="0.4 kg"), lambda line: None)
    found = fit(load(tmp_path / "toss.toml"), starts=4)
    low, high = found.parameters["friction_dynamic"].ci95 or (np.nan, np.nan)
    assert low < FRICTION < high and high - low < 0.2 * FRICTION


@pytest.mark.slow
def test_a_toss_that_the_model_goes_with_is_followed_to_its_end(tmp_path):
    init.run(write(tmp_path / "toss.csv", *toss()), tmp_path / "toss.toml", init.Said(mass="0.4 kg"), lambda line: None)
    problem = load(tmp_path / "toss.toml")
    (one,) = problem.experiments
    model = build(problem, problem.fitted)
    truth = dict(stiffness=STIFFNESS, damping=DAMPING, friction_dynamic=FRICTION, inertia=2 / 3 * MASS * HALF**2)
    start = np.array([truth[c.name] if c.name in truth else np.mean(one.bounds[c.name]) for c in model.coordinates])
    near = model.point(start)
    design = np.clip(near + 0.03 * np.random.default_rng(0).standard_normal((4, near.size)), 0.0, 1.0)
    found = search(problem, model, Screen(design, np.arange(4.0), np.ones(near.size)), [start], 2)
    values = dict(zip((c.name for c in found.model.coordinates), found.model.values(found.ends[0].point), strict=True))
    assert values["friction_dynamic"] == pytest.approx(FRICTION, rel=0.05)
    assert found.problem.experiments[0].times[-1] == pytest.approx(TIMES[-1]) and found.said == []
