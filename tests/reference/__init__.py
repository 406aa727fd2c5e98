"""The paper in plain Python: an independent reference for the closed loop of a coil valve with backlash.

Source: J. Cai and J. E. Braun, "Self-learning Backlash Inverse Control of Cooling or Heating Coil Valves
Having Backlash Hysteresis", International Refrigeration and Air Conditioning Conference at Purdue, 2016,
paper 1801, docs.lib.purdue.edu/iracc/1801.  Equation numbers (1) to (4) are the paper's.

It computes one scenario at a time with lists and floats, and shares no code with the package, only the names and
defaults of its parameters.  It follows the formulas literally: Eq (1) is the paper's three branches, saturation is the
Hyland-Wexler formula with math.exp and math.log, and the metrics are computed from the whole recorded run instead of
being accumulated in the loop.

Units: degC, kg/s, kJ, kW, s; commands, openings and backlash are fractions of stroke; humidity ratios are
kg of water per kg of dry air.  The time step is 1 s.
"""

from reference.coil import effectiveness, steady_state_dry
from reference.control import NoiseMeter, additive_compensation, backlash_inverse, pi_controller, smooth_inverse
from reference.loop import INPUTS, simulate
from reference.noise import philox4x32, standard_normal
from reference.parameters import PAPER_LIKE
from reference.psychrometrics import enthalpy, humidity_ratio, saturation_humidity_ratio, saturation_pressure
from reference.valve import NeutralZone, StickSlip, backlash, leaking_valve, richards_valve, valve_from_authority

__all__ = [
    "INPUTS", "PAPER_LIKE", "NeutralZone", "NoiseMeter", "StickSlip", "additive_compensation", "backlash",
    "backlash_inverse", "effectiveness", "enthalpy", "humidity_ratio", "leaking_valve", "philox4x32", "pi_controller",
    "richards_valve", "saturation_humidity_ratio", "saturation_pressure", "simulate", "smooth_inverse",
    "standard_normal", "steady_state_dry", "valve_from_authority",
]  # fmt: skip
