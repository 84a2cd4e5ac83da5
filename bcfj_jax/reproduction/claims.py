"""Every quantitative claim of the paper (Zhu et al., Machines 2023, 11(4), 466), as printed, with what is wrong with it where
something is. A number is in SI; a text is the paper's own, misprints included.
"""

from __future__ import annotations

from typing import NamedTuple

INPUT, FIGURE, STATEMENT = "input", "figure", "statement"


class Claim(NamedTuple):
    """One row of the paper's reference-load table."""

    # id, quantity, printed, section: Q1 to Q39; what is claimed; the paper's value, as printed; where it stands.
    id: str
    quantity: str
    printed: str
    section: str
    kind: str  # "input" (what the paper's simulation was given), "figure" (what it gave), "statement" (neither)
    # The printed numbers in SI, as the paper must have meant them; empty where there are none.
    values: tuple[float, ...] = ()
    unit: str = "1"  # of ``values``; "1" for none, "%" for a share shown as one
    remark: str = ""  # how it is read, and what contradicts it


CLAIMS: tuple[Claim, ...] = (
    Claim("Q1", "usual curvature radius of a wellbore", "1 to 4 m", "1", STATEMENT, (1.0, 4.0), "m"),
    Claim("Q2", "greatest swing angle of the ball-cage sub", "70 deg", "1", STATEMENT, (1.2217304763960306,), "rad",
          "not said whether in total or per joint"),
    Claim("Q3", "curvature radius simulated", "1 mm", "4", INPUT, (1.0,), "m", "misprint: 1 m, as Q1 says; it enters "
          "through the joint's angle alone (Q13)"),
    Claim("Q4", "time simulated", "3 s", "4", INPUT, (3.0,), "s"),
    Claim("Q5", "time step", "0.001 s", "4", INPUT, (0.001,), "s", "read as the output's: a contact may last 0.1 to 1 "
          "ms, so that peaks are under-sampled"),
    Claim("Q6", "density", "7.801 kg/cm3", "4", INPUT, (7801.0,), "kg/m^3", "misprint: 7.801 g/cm3 = 7801 kg/m3"),
    Claim("Q7", "elastic modulus E*", "207 GPa", "4", INPUT, (207e9,), "Pa", "Young's modulus of each body; the "
          "effective modulus of the pair is 113.0 GPa"),
    Claim("Q8", "Poisson's ratio", "0.29", "4", INPUT, (0.29,)),
    Claim("Q9", "static, dynamic friction", "0.12, 0.03", "4", INPUT, (0.12, 0.03)),
    Claim("Q10", "greatest elastic deformation", "0.1 mm", "4", INPUT, (1e-4,), "m", "read as the depth of IMPACT at "
          "which its damping is full"),
    Claim("Q11", "initial collision velocity", "1.5 m/s", "4", INPUT, (1.5,), "m/s", "taken from another work: the rim "
          "moves at 0.372 m/s at 100 r/min and 35.5 mm"),
    Claim("Q12", "nonlinear index n", "1.5", "4", INPUT, (1.5,), "1", "does not go with the units of the paper's K_n"),
    Claim("Q13", "included angle of head and seat", "157 deg", "4", INPUT, (0.4014257279586958,), "rad",
          "a deflection of 23 deg"),
    Claim("Q14", "speed", "100 r/min", "4", INPUT, (10.471975511965978,), "rad/s", "1.667 Hz, a turn in 0.600 s"),
    Claim("Q15", "resisting torque", "1.8 kN x m", "4", INPUT, (1800.0,), "N m", "read as 1.8 kN m"),
    Claim("Q16", "balls, windows, grooves", "6, 6, 6 + 6", "2", INPUT, (6.0,)),
    Claim("Q17", "period of point 1 (normal, axial, tangential)", "0.615, 0.613, 0.614 s", "4.1.1", FIGURE,
          (0.615, 0.613, 0.614), "s", "97.6 to 97.9 r/min: not the 0.600 s that 100 r/min gives"),
    Claim("Q18", "greatest error of these periods", "0.002 s", "4.1.1", FIGURE, (0.002,), "s",
          "among each other; against the 0.600 s of the input it is 0.015 s (2.5 %)"),
    Claim("Q19", "collision frequency", "1.63 Hz", "4.1.1", FIGURE, (1.63,), "Hz", "said to be consistent with the "
          "input, which is 1.667 Hz (-2.2 %); 1.633 Hz is the speed times cos(23 deg/2), to its digits: a cage that "
          "slips so much, or chance; the text does not say"),
    Claim("Q20", "peak normal force, point 1", "20.32 kN", "4.1.1", FIGURE, (20.32e3,), "N",
          "greatest of the three components"),
    Claim("Q21", "peak normal force, point 2", "21.28 kN", "4.1.2", FIGURE, (21.28e3,), "N"),
    Claim("Q22", "delay between points 1 and 2", "0.22 s", "4.1.2", FIGURE, (0.22,), "s"),
    Claim("Q23", "range of the normal force, point 3", "-15.75 to 14.69 kN", "4.1.3", FIGURE, (-15.75e3, 14.69e3), "N",
          "a window pushes from either side"),
    Claim("Q24", "the cage's equilibrium", "at t = 1.51 s", "4.1.3", FIGURE, (0.0,), "N", "the table of its forces is "
          "missing; tested here as |sum of forces - mass x acceleration|"),
    Claim("Q25", "period, frequency of point 4", "0.61 s, 1.63 Hz", "4.1.4", FIGURE, (0.61, 1.63), "s, Hz",
          "1/0.61 s is 1.639 Hz"),
    Claim("Q26", "peak resultant, point 4, balls 2 and 5", "39.84 kN", "4.1.4", FIGURE, (39.84e3,), "N",
          "on the inner side of the deflection"),
    Claim("Q27", "peak, point 5, ball 5", "38.76 kN", "4.1.5", FIGURE, (38.76e3,), "N"),
    Claim("Q28", "load lost in transfer", "2.71 %", "4.1.5", FIGURE, (0.0271,), "%",
          "(39.84 - 38.76)/39.84 = 2.711 %: right"),
    Claim("Q29", "first load of point 5 after that of point 4", "0.04 s (0.042 to 0.082 s)", "4.1.5, 4.2.1", FIGURE,
          (0.04,), "s"),
    Claim("Q30", "end of the start-up impacts", "0 to 0.042 s", "4.2.1", FIGURE, (0.042,), "s"),
    Claim("Q31", "time to stabilise", "0.585 s", "4.2.1", FIGURE, (0.585,), "s", "about one turn"),
    Claim("Q32", "order of the polynomial", "9", "4.2.2", INPUT, (9.0,)),
    Claim("Q33", "window of the fit, normal", "1.18 to 1.82 s", "4.2.2", INPUT, (1.18, 1.82), "s",
          "0.64 s: about one turn"),
    Claim("Q34", 'window of the fit, "normal" (second)', "1.52 to 2.75 s", "4.2.2", INPUT, (1.52, 2.75), "s",
          "misprint: axial, as the figure says; 1.23 s: about two turns"),
    Claim("Q35", "greatest amplitude, normal, cage on seat", "12.42 kN", "4.2.2", FIGURE, (12.42e3,), "N",
          "of the residual of the fit, not the peak of Q20"),
    Claim("Q36", "greatest amplitude, axial, cage on seat", "1.68 kN", "4.2.2", FIGURE, (1.68e3,), "N"),
    Claim("Q37", "qualitative claims", "normal far above axial and tangential at points 1, 2; residual of ball on "
          "groove below that of cage on seat; first wear at the inner race; larger clearance: fewer, higher impacts",
          "4.1, 4.2", FIGURE, (), "1", "each is tested as an inequality"),
    Claim("Q38", "contact points", "5 kinds, all of one point; axial load and torque on the upper three", "2, 4.2.1",
          STATEMENT, (), "1", "a choice of the model; no number is given for the axial load"),
    Claim("Q39", "stated assumptions", "room temperature, 1 atm, air, no vibration, no gravity; no laboratory or field "
          "test", "4.1.3, 4.2.2", STATEMENT, (), "1", "nothing in the paper was measured"),
)  # fmt: skip


def claim(id: str) -> Claim:
    """A claim by its id."""
    return next(row for row in CLAIMS if row.id == id)
