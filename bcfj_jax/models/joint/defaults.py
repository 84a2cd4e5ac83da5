"""The joint's default numbers, each with where it is from. Nothing here is a measurement of the paper's joint."""

from __future__ import annotations

import math

LEGEND = (
    "paper: Zhu et al., Machines 2023, 11(4), 466. group: sizes of the same group's optimised joint (Energies 2022, 15, "
    "7591), read as sphere diameters. derived: computed from these. GUESS: nowhere stated, chosen within what is usual. "
    "None of them was measured."
)
# Contact regularisation where pilots are full spheres: 20 um hold a ball that carries nothing. With bands it swings unstably.
SMOOTHING_OF_SPHERES = 20e-6
DEFAULTS: dict[str, tuple[float, str]] = {
    "drive_speed": (100.0 * 2.0 * math.pi / 60.0, "paper: 100 r/min"),
    "load_torque": (1800.0, "paper: resisting torque 1.8 kN m"),
    "load_ramp": (0.05, "GUESS: the paper does not say how the torque is raised"),
    "axial_load": (0.0, "GUESS: the paper names an axial load and gives no number"),
    "start_speed": (0.0, "GUESS: from rest; read by a drive over time only"),
    "drive_ramp": (0.585, "paper: stabilisation time .585 s, read as the drive's; read by a drive over time only"),
    "axial_ramp": (0.05, "GUESS: as the torque's; read by an axial load over time only"),
    "load_amplitude": (360.0, "GUESS: a fifth of the torque; read by a torque that fluctuates only"),
    "load_frequency": (5.0, "GUESS: three a turn, as a bit with three cones; read by a torque that fluctuates only"),
    "axial_amplitude": (4e3, "GUESS: a fifth of 20 kN; read by an axial load that fluctuates only"),
    "axial_frequency": (5.0, "GUESS: three a turn; read by an axial load that fluctuates only"),
    "reversal_time": (0.5, "GUESS; read by a torque that reverses only"),
    "reversal_ramp": (0.05, "GUESS: as the torque's rise; read by a torque that reverses only"),
    "stick_ratio": (
        2.0,
        "GUESS: usual in torsional models of drill strings; read by a torque that sticks and slips only",
    ),
    "stick_speed": (1.0, "GUESS: a tenth of the speed; read by a torque that sticks and slips only"),
    "stick_width": (0.1, "GUESS: a hundredth of the speed; read by a torque that sticks and slips only"),
    "joint_angle": (math.radians(23.0), "paper: 180 - 157 degrees"),
    "seat_radius": (0.040, "group: seat 80 mm"),
    "head_radius": (0.031, "group: head 62 mm"),
    "ball_radius": (0.008, "group: ball 16 mm"),
    "pitch_radius": (0.0355, "derived: midway between seat and head spheres (GUESS)"),
    "offset": (0.0045, "GUESS: track offset e of 0.08 to 0.14 pitch radii is usual"),
    "contact_angle": (math.radians(40.0), "GUESS: 35 to 45 degrees for gothic grooves"),
    "conformity": (0.52, "GUESS: groove radius over ball diameter, 0.505 to 0.54"),
    "clearance_seat_cage": (50e-6, "GUESS: radial, 20 to 100 um"),
    "clearance_head_cage": (50e-6, "GUESS: radial, 20 to 100 um"),
    "pilot_band": (math.radians(30.0), "GUESS: the cage ends at some 30 degrees of latitude"),
    "clearance_cage_ball": (10e-6, "GUESS: to either window face, up to 40 um"),
    "clearance_cage_window_end": (
        2.5e-3,
        "GUESS: to either end; balls swing by 0.36 mm in the cage at 23 deg, by 2.4 mm at 59",
    ),
    "clearance_seat_ball": (10e-6, "GUESS: normal to the flank, 10 to 60 um"),
    "clearance_head_ball": (10e-6, "GUESS: normal to the flank, 10 to 60 um"),
    "stiffness": (3.70e10, "derived: elliptic Hertz, ball in groove of conformity 0.52 (mean of both races)"),
    "cage_ball.stiffness": (1.3476e10, "derived: Hertz, ball on flat window"),
    "cage_window_end.stiffness": (1.3476e10, "derived: Hertz, ball on flat window end"),
    "seat_cage.stiffness": (8.518e11, "derived: Lankarani-Nikravesh, sphere in socket, 50 um"),
    "head_cage.stiffness": (6.606e11, "derived: Lankarani-Nikravesh, sphere in socket, 50 um"),
    "exponent": (1.5, "paper: nonlinear index 1.5"),
    "damping": (0.111, "GUESS: restitution 0.9 at 1.5 m/s"),
    "smoothing": (
        30e-6,
        "chosen: wider than the balls' clearance, so that free balls do not rattle; 20 um where pilots are no bands; "
        "benchmarks/models/joint_knobs.py, joint_fuller.py",
    ),
    "friction_static": (0.12, "paper"),
    "friction_dynamic": (0.03, "paper"),
    "friction_speed": (0.1, "GUESS: usual in multibody work; benchmarks/models/joint_knobs.py"),
    "friction_memory": (5e-3, "GUESS: 3 to 9 ms in a lubricated line contact (Hess and Soom 1990)"),
    "friction_viscous": (0.1, "GUESS: an oil film of 1 um with 200 Pa s at 2 GPa; 0.009 at 0.09 m/s"),
    "bristle_stiffness": (1e5, "GUESS: bristles bend by 1.2 um until break-away"),
    "bristle_damping": (1.0, "GUESS"),
    "ball_mass": (0.016731, "derived: steel sphere, 7801 kg/m^3"),
    "cage_mass": (0.4, "GUESS: 0.3 to 0.5 kg"),
    "cage_inertia": (3.36e-4, "GUESS: spherical shell of the cage's mass at the pitch radius"),
    "head_mass": (1.5, "GUESS: steel sphere of 62 mm and a stub of shaft"),
    "head_inertia": (1e-3, "GUESS: about its own axis"),
    "seat_inertia": (5e-3, "GUESS: about its own axis; read by a flexible drive only"),
    "drive_stiffness": (2e5, "GUESS: torsion of the drive; read by a flexible drive only"),
    "drive_damping": (50.0, "GUESS; read by a flexible drive only"),
    "effective_modulus": (113.0e9, "derived: steel on steel, 207 GPa, 0.29 (paper)"),
    "contact_length": (16e-3, "GUESS: the ball's diameter"),
    "radius": (8e-3, "group: ball 16 mm"),
    "radius_difference": (50e-6, "GUESS"),
    "reference_force": (1.17e4, "derived: the power law's force at the reference penetration"),
    "reference_penetration": (46.4e-6, "derived: elliptic Hertz at 12 kN"),
    "bottoming_stiffness": (1e9, "GUESS"),
    "bottoming_penetration": (46.4e-6, "GUESS: the reference penetration"),
    "bottoming_width": (5e-6, "GUESS"),
    "bottoming_damping": (0.111, "GUESS: the layer's"),
    "restitution": (0.9, "GUESS"),
    "approach_speed": (1.5, "paper: initial collision velocity"),
    "dashpot": (1000.0, "GUESS"),
    "damping_depth": (1e-4, "paper: maximum elastic deformation 0.1 mm, read as the depth of IMPACT"),
}
