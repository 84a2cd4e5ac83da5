"""What calibration files and their tables may hold, and what becomes of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from problems import FORCES, PROBLEM, TABLE, swap

from calibration.problemfile import load

pytestmark = pytest.mark.filterwarnings("error")


def test_accuracy_is_what_the_file_says(here):
    assert load("p.toml").accuracy == 1e-6
    swap("scene", "accuracy = 1e-4\nscene")()
    assert load("p.toml").accuracy == 1e-4


def loaded(table: str, entry: str = "") -> tuple:
    Path("d.csv").write_text(table, encoding="utf-8")
    swap("noise", entry + "\nnoise")()
    return load("p.toml").experiments


def test_tables_may_quote_lead_with_a_mark_and_leave_blanks(here):
    text = '\ufeff"time [ms]","force, filtered [kN]",note\r\n"0","-0.25","a, b"\r\n\r\n'
    text += '1,,\r\n2," -0.5 ",\r\n3,NaN,\r\n4,-0.25,\r\n'
    swap("force [N]", "-force, filtered [kN]")()
    (one,) = loaded(text)
    np.testing.assert_array_equal(one.times, [0.0, 1e-3, 2e-3, 3e-3, 4e-3])
    np.testing.assert_array_equal(one.channels[0].values, [250.0, np.nan, 500.0, np.nan, 250.0])
    assert one.channels[0].sigma == 1.0


RUNS = "{0},time [ms],force [N]\n" + "".join(f"{r},{t},{10 * r + t * (3 - t)}\n" for r in (1, 2, 3) for t in range(4))


@pytest.mark.parametrize(
    ("column", "entry", "names", "firsts"),
    [
        ("run", "", ["run 1", "run 2", "run 3"], [10, 20, 30]),
        ("shot", "rows = { shot = [1, 3] }", ["shot 1", "shot 3"], [10, 30]),
        ("shot", "rows = { shot = 2 }", ["d"], [20]),
        ("run", "rows = { run = [2, 3] }", ["run 2", "run 3"], [20, 30]),
    ],
    ids=["run column", "list", "one", "some runs"],
)
def test_runs_and_lists_of_rows_become_experiments(column, entry, names, firsts, here):
    experiments = loaded(RUNS.format(column), entry)
    assert [e.name for e in experiments] == names
    for experiment, first in zip(experiments, firsts, strict=True):
        np.testing.assert_array_equal(experiment.channels[0].values, first + np.array([0.0, 2.0, 2.0, 0.0]))


def test_first_contact_and_window(here):
    # The pulse first exceeds a tenth of its peak at 0.1 ms (sin 18 deg = 0.31): that becomes time 0.
    (one,) = loaded(TABLE, 'align = "onset"\nwindow = ["-0.05 ms", "0.45 ms"]')
    np.testing.assert_allclose(one.times, [0.0, 1e-4, 2e-4, 3e-4, 4e-4], atol=1e-18)
    np.testing.assert_allclose(one.channels[0].values, FORCES[1:6], rtol=1e-7)


@pytest.mark.parametrize(
    ("entry", "sigma", "relative", "memory"),
    [
        ('"2 %"', 2.0, 0.0, 0.0),
        ("3.0", 3.0, 0.0, 0.0),
        ('"0.003 kN + 4 % + 5 % of reading"', 5.0, 0.05, 0.0),
        ('{ "contact.normal" = "2 N" }', 2.0, 0.0, 0.0),
        ('"estimate"\ncorrelation = "0.2 ms"', None, 0.0, 2e-4),
        ('"2 N"\ncorrelation = "estimate"', 2.0, 0.0, None),
    ],
)
def test_noise(entry, sigma, relative, memory, here):
    """A percentage is of the largest reading, 100 N; independent parts add in their squares."""
    swap('"1 N"', entry)()
    channel = load("p.toml").experiments[0].channels[0]
    assert (channel.relative, channel.correlation) == (pytest.approx(relative), memory)
    assert channel.sigma == (sigma if sigma is None else pytest.approx(sigma, rel=1e-6))


def test_features_beside_and_instead_of_histories(here):
    only = '[[experiment]]\nfeatures = { "contact.peak" = "0.1 kN" }\nfeature_noise = "2 %"\nspan = "5 ms"\n'
    swap("[free", only + "[free")()
    swap("noise", 'name = "drop"\nfeatures = { "contact.impulse" = 0.06 }\nfeature_noise = "1 mN s"\nnoise')()
    first, second = load("p.toml").experiments
    assert [(o.feature, o.value, o.sigma) for o in first.features] == [("contact.impulse", 0.06, 1e-3)]
    assert [(o.feature, o.value, o.sigma) for o in second.features] == [("contact.peak", 100.0, 2.0)]
    assert (first.name, second.name, second.span, second.channels) == ("drop", "[[experiment]] 2", 5e-3, ())


def test_two_records_never_share_a_name(here):
    entry = PROBLEM[PROBLEM.index("[[exp") : PROBLEM.index("[free")]
    swap("[free", entry + "[free")()
    assert [e.name for e in load("p.toml").experiments] == ["d", "d (2)"]
