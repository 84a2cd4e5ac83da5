"""Numbers that others published, or that a closed form or another program gives. Nothing here comes from this package.

Each constant names its source. "DOP853" is SciPy's integrator at a relative tolerance of 1e-12 on the formula itself.
Printed digits are kept as text where a comparison asks for the last one of them.
"""

from __future__ import annotations

from typing import NamedTuple

# --- restitution: F = K d^n (1 + chi d'/v0)

RESTITUTION_LAWS = (
    "hunt_crossley", "herbert_mcwhannell", "lee_wang", "lankarani_nikravesh", "gonthier", "zhiying_qishao",
    "flores", "hu_guo", "carvalho_martins", "zhang", "safaeifar_farshidianfar",
)  # fmt: skip
# e asked for; chi of the exact relation chi (1 + e) = ln[(1 + chi)/(1 - chi e)]; e delivered by each law. By DOP853.
RESTITUTION = tuple(
    tuple(line.split())
    for line in """
.10 9.998159 .51583 .49070 .68666 .66527 .10099 .21747 .06944 .07407 .12894 .09541 .08888
.20 4.919167 .54685 .50078 .71195 .67226 .20461 .26642 .15554 .16560 .21159 .19601 .19698
.30 3.087082 .58129 .51997 .73900 .68422 .30422 .32670 .25621 .27066 .30397 .30166 .31376
.40 2.082498 .61974 .55031 .76800 .70163 .39779 .39884 .36287 .37965 .40109 .40621 .42793
.50 1.432751 .66296 .59362 .79920 .72524 .48774 .48261 .47044 .48774 .50017 .50810 .53616
.60 .974872 .71195 .65107 .83287 .75615 .57728 .57690 .57728 .59362 .59997 .60764 .63831
.70 .634828 .76800 .72268 .86934 .79597 .66958 .67957 .68318 .69730 .69997 .70569 .73502
.80 .373146 .83287 .80698 .90902 .84710 .76800 .78736 .78854 .79920 .79999 .80314 .82707
.90 .166482 .90902 .90089 .95237 .91318 .87644 .89592 .89392 .89990 .90000 .90094 .91519
.95 .078927 .95237 .95011 .97561 .95351 .93593 .94886 .94683 .94999 .95000 .95026 .95798
.99 .015151 .99010 .99000 .99502 .99015 .98678 .98995 .98934 .99000 .99000 .99001 .99165
""".strip().splitlines()
)
# e; greatest penetration and peak force over those of the undamped impact; d'/v0 at the peak; duration over the undamped.
# Exact chi, n = 1.5, by DOP853.
DAMPED_RATIOS = (
    (".95", ".979821", ".972271", ".06225", "1.005385"),
    (".90", ".959263", ".949202", ".12297", "1.011621"),
    (".80", ".916881", ".917289", ".23419", "1.027241"),
    (".70", ".872517", ".903836", ".32654", "1.048450"),
    (".50", ".775583", ".929682", ".45683", "1.119791"),
    (".30", ".658900", "1.040902", ".53814", "1.286036"),
)
# T0 v0/d0 of an undamped impact, by exponent: 2 sqrt(pi) G(1 + 1/(n+1))/G(1/2 + 1/(n+1)).
UNDAMPED_DURATIONS = {
    1.0: "3.141593", 1.1: "3.095387", 1.5: "2.943275", 2.0: "2.804364", 2.5: "2.701449", 3.0: "2.622058",
}  # fmt: skip
# Damping ratio c/(2 sqrt(K m)) of a linear dashpot; restitution where contact ends at F = 0 (Schwager and Poeschel 2007)
# and where it ends at d = 0, exp(-pi z/sqrt(1 - z^2)).
KELVIN_VOIGT = (
    (0.1, ".7440794", ".7292476"),
    (0.5, ".2984361", ".1630335"),
    (0.75, ".1941727", ".0283754"),
    (1.2, ".1052105", None),
)
# Hunt and Crossley's K d^n (1 + a d') at a v0 = 0.8: the same for every exponent.
HUNT_CROSSLEY = 0.6479674249

# ADAMS' IMPACT, k = 1e5 N/mm^n, d = 0.1 mm, by DOP853: mass [kg], speed [m/s], cmax [N s/mm]; restitution, duration [s],
# penetration [m], peak [N]; n.
ADAMS_IMPACT = tuple(
    tuple(line.split())
    for line in """
1 1 1 .834458 5.20538e-4 1.61551e-4 6547.59 1.5
1 1 10 .241777 6.99251e-4 1.07667e-4 7660.38 1.5
1 .1 10 .817497 8.28285e-4 2.53779e-5 424.737 1.5
1 .1 50 .483485 9.18593e-4 2.09358e-5 456.326 1.5
1 1.5 50 .0381862 1.66883e-3 7.54011e-5 26615.3 1.5
5 1.5 50 .0778163 1.83105e-3 1.72292e-4 55736.1 1.5
1 1 10 .087397 1.84683e-3 1.30318e-4 6495.55 2.2
""".strip().splitlines()
)

# --- stiffness


class Spheres(NamedTuple):
    """Chung and Ooi, Granular Matter 13 (2011) 643: an elastic collision, the closed form's numbers and the curve's."""

    material: tuple[float, float, float, float]
    """E and nu of both bodies [Pa, -]."""
    radii: tuple[float, float]
    """[m]"""
    mass: float
    """Effective [kg]."""
    speed: float
    """Closing [m/s]."""
    closed: tuple[float, float, float, float]
    """K [N/m^1.5], penetration [m], peak force [N], duration [s]."""
    published_peak: float
    """Peak of the published, digitised force history [N]."""


_BALL = 4.0 / 3.0 * 3.141592653589793
CHUNG_OOI = (
    Spheres(
        (48e9, 0.2, 48e9, 0.2), (0.01, 0.01), 2800.0 * _BALL * 0.01**3 / 2, 20.0,
        (2.357023e9, 274.113e-6, 10.6969e3, 40.339e-6), 10.704e3,
    ),
    Spheres(
        (70e9, 0.3, float("inf"), 0.3), (0.1, float("inf")), 2699.0 * _BALL * 0.1**3, 0.2,
        (3.243362e10, 49.717e-6, 11.3699e3, 731.66e-6), 11.357e3,
    ),
)  # fmt: skip

STEEL = 113.0036e9  # E* [Pa] of E = 207 GPa, nu = 0.29 on itself
# Sphere of 40 mm in a spherical socket with this clearance [m]: K = (4/3) E* sqrt(Rs Rb/dR) (Lankarani and Nikravesh).
SOCKETS = ((50e-6, "8.518e11"), (100e-6, "6.019e11"), (500e-6, "2.678e11"))
BALL_ON_FLAT = "1.3476e10"  # (4/3) E* sqrt(8 mm)
# Elliptic Hertz, ball of 8 mm in a groove on a track of 35.8 mm at 45 degrees: outer?, conformity; k, K, then penetration
# [um] and pressure [GPa] at 11.9511 kN and at 39.84 kN.
RACES = (
    (True, 0.505, "16.78 6.245e10 33.2 2.34 74.1 3.49"),
    (True, 0.52, "7.439 3.782e10 46.4 3.09 103.5 4.62"),
    (True, 0.54, "4.955 3.012e10 54.0 3.58 120.5 5.34"),
    (False, 0.505, "20.23 6.019e10 34.0 2.71 75.9 4.05"),
    (False, 0.52, "9.033 3.617e10 47.8 3.57 106.7 5.34"),
    (False, 0.54, "6.045 2.865e10 55.8 4.12 124.6 6.15"),
)

# --- mechanisms

# A row of equal spheres, the first at 1 m/s: final velocities by (number of spheres, exponent). siconos' ChainOfBalls by
# DOP853; they depend on neither stiffness, mass nor speed.
CHAIN = {
    (10, 1.5): (
        *(-0.071085017, -0.030273789, -0.015833397, -0.008885695, -0.005126583),
        *(-0.002985978, -0.001737668, 0.002671955, 0.147390307, 0.985865866),
    ),
    (3, 1.5): (-0.070952354, 0.076403039, 0.994549315),
    (4, 1.5): (-0.071085016, -0.029626196, 0.109738640, 0.990972573),
    (5, 1.5): (-0.071085017, -0.030273764, -0.014463629, 0.127044986, 0.988777424),
    (3, 1.0): (-0.1302617, 0.1502296, 0.9800321),
    (5, 1.0): (-0.132279485, -0.075329170, -0.031010829, 0.296217750, 0.942401733),
    (3, 2.0): (-0.0378804, 0.0393741, 0.9985063),
}
# Flores, Leine and Glocker's slider-crank with play in its guide (2010), before it touches, by DOP853: time [s], crank
# [turns], rod [rad], their speeds [rad/s]; and the first touch [s].
SLIDER_GUIDE = (
    (0.001, 0.0232510799, -0.0725963954, 139.1158758, -68.2762942),
    (0.002, 0.0438940444, -0.1349492639, 120.4638817, -56.4733942),
)
SLIDER_GUIDE_TOUCH = 0.002692503

# What the joint's references have: balls that do not spin, windows without ends, pilots that are spheres.
JOINT_OPTIONS = {"spin": False, "window_ends": False, "bands": False}
# The joint undeflected, 1800 N m, track offset 4.5 mm, pitch radius 35.5 mm: contact angle [deg]; groove force
# T/(6 Rp sin a), window force 2 Q cot(a) e/Rc and the sum of window forces [N].
JOINT_OFFSET, JOINT_PITCH_RADIUS = 4.5e-3, 35.5e-3
JOINT_UNDEFLECTED = (
    (30, 16901.0, 3681.0, 22.09e3),
    (35, 14733.0, 3035.0, 18.21e3),
    (40, 13147.0, 2533.0, 15.20e3),
    (45, 11951.1, 2125.4, 12.75e3),
)
# Deflected by 10 degrees at a contact angle of 40 degrees, equal linear contacts, balls at 0, 60, ..., 300 degrees
# counted against the drive: groove and window forces [N], by a statics solve in NumPy.
JOINT_DEFLECTED_GROOVES = (15221.3, 6198.3, 5868.7, 15018.1, 18403.3, 18334.8)
JOINT_DEFLECTED_WINDOWS = (2921.5, 1791.1, 1695.9, 2882.5, 1746.5, 1740.0)
# The plain joint in motion at 1.5 s: normal forces [N] by CVODES at 1e-9 on equations written for CasADi, which share no
# code with this package (benchmarks/models/joint_reference.py; LSODA agrees to 1e-8 of the peak).
JOINT_MOVING_AT = 1.5
JOINT_MOVING = {
    "seat_cage": (4554.374512,),
    "head_cage": (7210.551758,),
    "cage_ball": (3016.797363, 535.022278, 0.857451, 4440.097656, -746.014832, 1133.736084),
    "seat_ball": (25361.564453, 1297.519165, 2.277552, 27376.533203, 9494.267578, 8638.984375),
    "head_ball": (25363.679688, 1217.141602, 1.493714, 27255.111328, 9401.346680, 8948.010742),
}
