"""Files that use every table and most keys, for changes of each of their values (``mutations.of_nodes``)."""

MECHANISM = """[scene]
kind = "mechanism"
law = "memory_free"
elastic = "power"
friction = "coulomb_tanh"
smoothing = true
[quantity.rod]
unit = "m"
lower = "1 mm"
upper = 1.0
default = "0.1 m"
meaning = "length of the rod"
[[body]]
name = "crank"
joint = "hinge"
axis = "z"
mass = 1.0
inertia = "1e-3 kg m^2"
drive = { kind = "ramp", speed = "10 rad/s", over = "10 ms", first = 0.0, shape = "smooth" }
[[body]]
name = "slider"
joint = "slide"
axis = [1.0, 0.0, 0.0]
at = ["rod", 0, 0]
center = [0, 0, 0]
mass = "200 g"
start = { position = "1 mm", velocity = 0.1 }
[[body]]
name = "cart"
joint = "hinge"
parent = "slider"
axis = "z"
tilt = ["x", 0.1]
mass = 0.1
inertia = [1e-4, 1e-4, 1e-4]
[[contact]]
name = "stop"
between = ["ground", "slider"]
gap = { kind = "two_sided_stop", axis = "x" }
at = [["rod", 0, 0], [0, 0, 0]]
law = "memory_free"
friction = false
values = { stiffness = 1e8 }
[[load]]
kind = "gravity"
direction = "-y"
[[load]]
kind = "force"
name = "push"
body = "slider"
direction = "x"
table = [[0.0, 1e-3, 2e-3], [0.0, 1.0, 0.0]]
[[load]]
kind = "torque"
name = "turn"
body = "cart"
direction = "z"
size = "1 N m"
ramp = "1 ms"
amplitude = 0.1
frequency = "10 Hz"
[[load]]
kind = "spring"
name = "spring"
between = ["ground", "slider"]
at = [[0, 0, 0], [0, 0, 0]]
stiffness = "1 kN/m"
damping = 1.0
free_length = "10 mm"
[[read]]
of = "slider.acceleration.x"
frame = "crank"
[parameters]
exponent = 1.5
damping = 0.1
clearance_stop = "1 mm"
[time]
end = "10 ms"
samples = 101
longest_step = "1 ms"
[accuracy]
force_error = "1 %"
"""

CALIBRATION = """scene = "impact"
loss = "linear"
accuracy = 1e-4
adequate = "5 %"
sensor = "free"
[[experiment]]
file = "whole.csv"
time = "time [ms]"
observe = { "contact.normal" = "force [N]" }
noise = "1 N"
hold_out = false
parameters = { mass = "100 g" }
separator = ","
decimal = "."
[free.stiffness]
lower = 1e6
upper = 1e10
start = 1e8
scale = "log"
[free.time_offset]
lower = "-5 us"
upper = "5 us"
"""

STUDY = """scene = "impact"
[design]
kind = "latin_hypercube"
points = 16
seed = 3
[vary.stiffness]
lower = 1e9
upper = 1e11
scale = "log"
[vary.mass]
lower = "10 g"
upper = "20 g"
[results]
features = ["contact.peak", "contact.impulse"]
histories = false
derivatives = ["stiffness"]
"""

DESIGN = """scene = "impact"
[objective]
minimize = "contact.peak"
[vary.damping]
lower = 0.1
upper = 1.0
tolerance = 0.01
[vary.mass]
lower = "10 g"
upper = "20 g"
[search]
starts = 4
kappa = 0.5
distribution = "normal"
samples = 16
iterations = 10
seed = 1
confirm = true
"""
