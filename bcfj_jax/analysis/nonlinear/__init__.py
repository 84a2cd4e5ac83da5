"""Nonlinear dynamics of a scene: sections, bifurcations, Lyapunov exponents, portraits (``docs/nonlinear.md``).

Nothing else of the package imports it.
"""

from bcfj_jax.analysis.nonlinear.diagrams import Diagram as Diagram
from bcfj_jax.analysis.nonlinear.diagrams import bifurcation as bifurcation
from bcfj_jax.analysis.nonlinear.diagrams import impact_bifurcation as impact_bifurcation
from bcfj_jax.analysis.nonlinear.diagrams import map_bifurcation as map_bifurcation
from bcfj_jax.analysis.nonlinear.exponents import Exponent as Exponent
from bcfj_jax.analysis.nonlinear.exponents import flow_exponent as flow_exponent
from bcfj_jax.analysis.nonlinear.exponents import flow_step as flow_step
from bcfj_jax.analysis.nonlinear.exponents import map_exponent as map_exponent
from bcfj_jax.analysis.nonlinear.exponents import scene_exponent as scene_exponent
from bcfj_jax.analysis.nonlinear.exponents import two_trajectories as two_trajectories
from bcfj_jax.analysis.nonlinear.portraits import MODES as MODES
from bcfj_jax.analysis.nonlinear.portraits import ball_loads as ball_loads
from bcfj_jax.analysis.nonlinear.portraits import contact_modes as contact_modes
from bcfj_jax.analysis.nonlinear.portraits import contact_portrait as contact_portrait
from bcfj_jax.analysis.nonlinear.portraits import contact_raster as contact_raster
from bcfj_jax.analysis.nonlinear.portraits import draw_bifurcation as draw_bifurcation
from bcfj_jax.analysis.nonlinear.portraits import draw_exponent as draw_exponent
from bcfj_jax.analysis.nonlinear.portraits import draw_section as draw_section
from bcfj_jax.analysis.nonlinear.portraits import state_portrait as state_portrait
from bcfj_jax.analysis.nonlinear.sections import Impacts as Impacts
from bcfj_jax.analysis.nonlinear.sections import Section as Section
from bcfj_jax.analysis.nonlinear.sections import drive_period as drive_period
from bcfj_jax.analysis.nonlinear.sections import impacts as impacts
from bcfj_jax.analysis.nonlinear.sections import period_number as period_number
from bcfj_jax.analysis.nonlinear.sections import stroboscopic as stroboscopic
