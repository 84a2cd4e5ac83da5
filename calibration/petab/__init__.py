"""PEtab 2, the tables in which other fitting tools keep a problem: out and in. Needs the extra ``petab``.

| in PEtab | here |
|---|---|
| model, language ``bcfj`` | the scene file |
| parameter table | free parameters with their bounds; fixed ones |
| observable table | channels and features; gain and offset in the formula, noise as its formula |
| condition table | what is known of an experiment alone, its own free parameters, its noise |
| experiment and measurement table | the records |
| mapping table | names that are no PEtab identifiers, as in "seat_ball.stiffness" |
| extension ``bcfj`` | what PEtab has no place for: loss, scales, starts, correlated noise, held-out records |
"""

from calibration.petab.reading import load as load
from calibration.petab.writing import export as export
