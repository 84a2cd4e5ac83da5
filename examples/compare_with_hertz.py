"""Prints a fit of the Chung-Ooi curve beside Hertz's theory: python compare_with_hertz.py FOLDER_OF_RESULTS."""

import json
import math
import sys
from pathlib import Path

# Chung and Ooi 2011, test 1: two glass spheres; Hertz gives K = (4/3) E* sqrt(R) with these.
MODULUS, POISSON, RADIUS = 48e9, 0.2, 10e-3
DEPTH = 0.2e-3

folder = Path(sys.argv[1])
fit = json.loads((folder / "fit.json").read_text())
stiffness = fit["parameters"]["stiffness"]["value"]
exponent = fit["parameters"]["exponent"]["value"]
effective_modulus = MODULUS / (2 * (1 - POISSON**2))
theory = 4 / 3 * effective_modulus * math.sqrt(RADIUS / 2)
rows = [
    ("stiffness K [N/m^n]", stiffness, theory),
    ("exponent n", exponent, 1.5),
    ("force at 0.2 mm [kN]", stiffness * DEPTH**exponent / 1e3, theory * DEPTH**1.5 / 1e3),
]
print(f"\n{'':24}{'fitted':>14}{'Hertz':>14}{'difference':>12}")
for name, fitted, expected in rows:
    print(f"{name:24}{fitted:14.5g}{expected:14.5g}{fitted / expected - 1:12.2%}")
print(f"\nverdict: {fit['verdict']}; pictures: {folder}/fit.png, {folder}/force_penetration.png")
