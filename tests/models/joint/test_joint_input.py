"""What a joint refuses, how it says so, and the file to start from."""

from __future__ import annotations

import jax
import numpy as np
import pytest
from commands import bcfj
from conftest import BUILD

from bcfj_jax import scenes
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.quantities import check_order
from bcfj_jax.io.scenefile import load

GROOVES = ("seat_ball", "head_ball")


REFUSED = [
    ({"track": "gothik"}, ["scene 'joint' track", "'gothik'", "did you mean 'gothic'?"]),
    ({"cage": "free-floating"}, ["scene 'joint' cage", "'free-floating'", "free"]),
    ({"head": "loose"}, ["scene 'joint' head", "'loose'", "fixed, free"]),
    ({"drive": "prescibed"}, ["scene 'joint' drive", "did you mean 'prescribed'?"]),
    ({"fidelity": "static"}, ["scene 'joint' fidelity", "did you mean 'quasistatic'?"]),
    ({"balls": 2}, ["scene 'joint' balls", "2 balls", "3 or more"]),
    ({"law": "herz"}, ["law", "'herz'", "did you mean 'hertz'?"]),
    ({"friction": "brown"}, ["friction", "'brown'", "did you mean 'brown_mcphee'?"]),
    ({"elastic": "liuu"}, ["elastic", "'liuu'", "did you mean 'liu'?"]),
    ({"laws": {"cage_bal": "hertz"}}, ["scene 'joint' laws", "no contact 'cage_bal'", "did you mean 'cage_ball'?"]),
    ({"frictions": {"ball": False}}, ["scene 'joint' frictions", "no contact 'ball'"]),
    ({"laws": {"cage_ball": "hertz"}, "contacts": GROOVES}, ["joint' laws", "not among the contacts", "seat_ball"]),
    ({"contacts": ("seat_ball", "headball")}, ["scene 'joint' contacts", "no contact 'headball'", "'head_ball'"]),
    ({"contacts": ("seat_ball",)}, ["scene 'joint' contacts", "without head_ball", "both tracks"]),
    ({"contacts": ("seat_cage", *GROOVES), "cage": "fixed"}, ["seat_cage with a fixed cage", "remove it"]),
]


@pytest.mark.parametrize(("options", "parts"), REFUSED, ids=[",".join(o) + str(i) for i, (o, _) in enumerate(REFUSED)])
def test_options_that_are_refused(options, parts):
    with pytest.raises(InputError) as caught:
        scenes.make("joint", **options)
    for part in parts:
        assert part in str(caught.value)


def test_single_options_are_still_taken_with_a_warning_that_names_their_group():
    old = {"spin": False, "cage": "fixed", "friction": False, "drive": "flexible", "load_profile": "step"}
    with pytest.warns(DeprecationWarning, match=r"cage=bj.scenes.JointCage\(cage=...\), drive=bj.scenes.JointDrive"):
        found = scenes.joint(**old)
    assert found == scenes.make("joint", **old)
    assert found == scenes.joint(
        scenes.JointGeometry(spin=False), scenes.JointCage("fixed"), scenes.JointMaterials(friction=False),
        scenes.JointDrive("flexible"), scenes.JointLoads("step"),
    )  # fmt: skip
    with pytest.raises(InputError, match="no option 'spn'"):
        scenes.joint(spn=False)
    with pytest.raises(InputError, match=r"geometry = 'hertz'.*give geometry = bj.scenes.JointGeometry"):
        scenes.joint("hertz")


def test_parameters_that_are_refused():
    scene = scenes.joint()
    for values, parts in (
        ({"clearance_seat_bal": 1e-5}, ["no parameter 'clearance_seat_bal'", "did you mean 'clearance_seat_ball'?"]),
        ({"seat_ball.dashpot": 1.0}, ["no parameter 'seat_ball.dashpot'", "seat_ball.damping"]),
        ({"clearance_cage_ball": -1e-6}, ["clearance_cage_ball = -1e-06 m", ">= 0"]),
        ({"joint_angle": 1.6}, ["joint_angle = 1.6 rad", "<= 1.5"]),
        ({"seat_ball.stiffness": np.nan}, ["seat_ball.stiffness = nan", "of seat_ball alone"]),
    ):
        with pytest.raises(InputError) as caught:
            scene.parameters(values)
        for part in parts:
            assert part in str(caught.value)


JOINT = '[scene]\nkind = "joint"\n'
BAD = [
    (JOINT + "[parameters]\nclearance_seat_ball = -1e-5\n", ["[parameters] clearance_seat_ball", "-1e-05 m", ">= 0"]),
    (JOINT + '[parameters]\nball_radius = "4 mm"\n', ["ball_radius", "0.004 m", "does not reach both tracks"]),
    (JOINT + '[parameters]\npitch_radius = "45 mm"\n', ["pitch_radius", "away from the head's track", "or less"]),
    (JOINT + "track = 3\n", ["[scene] track", "3 is"]),
    (JOINT + '[parameters]\njoint_angle = "80 deg"\n', ["joint_angle", "80 deg", "into the seat", "at most"]),
    (JOINT + "[parameters]\nfriction_dynamic = 0.2\n", ["friction_dynamic = 0.2", "friction_static = 0.12", "<="]),
    (JOINT + "[parameters]\nfriction_static = -1\n", ["friction_static = -1 is out of range"]),
]


@pytest.mark.parametrize(
    ("text", "parts"), BAD, ids=["negative", "ball", "pitch", "option", "angle", "friction", "plain number"]
)
def test_bad_joint_files_exit_2_and_write_nothing(text, parts, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("BCFJ_CACHE", str(BUILD / "jax-cache"))
    (tmp_path / "s.toml").write_text(text, encoding="utf-8")
    for out in ([], ["--out", "out"]):
        done = bcfj("simulate", "s.toml", *out)
        assert done.exit_code == 2 and done.stdout == ""
        for part in ["error: s.toml", *parts]:
            assert part in done.stderr
        assert [path.name for path in tmp_path.iterdir()] == ["s.toml"]


def refused(known, values):
    with pytest.raises(InputError) as caught:
        check_order("here", known, values)
    return str(caught.value)


def test_sliding_friction_above_static_is_refused_where_a_contact_reads_both():
    shared = ("friction_static", "friction_dynamic")
    own = tuple(f"seat_ball.{name}" for name in shared)
    good = {"friction_static": 0.12, "friction_dynamic": 0.12}
    check_order("here", shared + own, good)
    assert refused(shared, good | {"friction_dynamic": 0.2}).startswith("here: friction_dynamic = 0.2 is more than")
    # A contact's own number beside the shared one; a batch; what is traced cannot be looked at.
    assert "seat_ball.friction_dynamic = 0.2" in refused(shared + own, good | {own[1]: 0.2})
    assert "give friction_dynamic <= seat_ball.friction_static" in refused(shared + own, good | {own[0]: 0.1})
    assert "= 0.3 is" in refused(shared, good | {"friction_dynamic": np.array([0.1, 0.3])})
    jax.jit(lambda x: check_order("here", shared, good | {"friction_dynamic": x}))(0.2)
    # Coulomb's law reads no static coefficient.
    check_order(
        "here", ("friction_dynamic", "seat_ball.friction_dynamic", "friction_static"), {"friction_dynamic": 1.0}
    )


def test_init_joint_writes_a_file_of_the_defaults(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert bcfj("init", "joint").exit_code == 0
    assert load("joint.toml").resolved == load("joint").resolved
