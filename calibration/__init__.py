"""Calibration of a scene's parameters from records of forces, accelerations or any other reading, with a verdict.

Reading order: ``problem`` (plain data), ``forward.model`` (residuals), ``search`` (optima), ``diagnostics`` (tests), ``fit``.
"""

from bcfj_jax import __version__ as __version__
from calibration.filters import Filter as Filter
from calibration.fit import Fit as Fit
from calibration.fit import fit as fit
from calibration.problem import Channel as Channel
from calibration.problem import Experiment as Experiment
from calibration.problem import Free as Free
from calibration.problem import Observation as Observation
from calibration.problem import Problem as Problem
from calibration.problemfile import load as load
from calibration.selection.choice import choose as choose
from calibration.selection.next_experiment import Candidate as Candidate
from calibration.selection.next_experiment import next_experiment as next_experiment


def __dir__() -> list[str]:
    public = ("Fit", "Channel", "Experiment", "Free", "Observation", "Problem", "Candidate")
    return sorted(["__version__", "fit", "load", "choose", "next_experiment", *public])
