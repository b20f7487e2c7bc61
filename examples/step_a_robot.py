"""Make a robot in two engines, pull one cable, and compare where the tip goes.

python examples/step_a_robot.py
"""

import numpy as np

from cdcsr.robot.description import load_robot
from cdcsr.simulation.engines import make_simulation

robot = load_robot("paper")
command = np.zeros((1, robot.num_cables))  # set-points of the servos, in m; one row a copy
command[0, 0] = -2.0
for engine in ("mujoco", "pybullet"):
    simulation = make_simulation(robot, engine)
    simulation.step(command, substeps=200)
    state = simulation.state()
    tip, tension = state.tip_position[0].round(3), state.cable_tension[0, 0]
    print(f"{engine}: after {state.time[0]:.2f} s the tip is at {tip} m, tension {tension:.1f} N")
    simulation.close()
