"""Measure a controller of your own beside a shipped policy, in two engines.

python examples/own_controller.py
"""

import numpy as np

from cdcsr.robot.description import load_robot
from cdcsr.simulation.state import State
from controllers.controller import Controller, Target
from training.measure.transfer_matrix import format_table, transfer
from training.policy import find_policy

robot = load_robot("paper")
angles = np.concatenate([np.radians(part.cables.angles_deg) for part in robot.segments])


class Pull(Controller):
    """Pulls the cables on the side of the target; it reaches few."""

    name = "pull"

    def act(self, state: State, target: Target, time: np.ndarray) -> np.ndarray:
        apart = target.position - state.tip_position
        towards = np.cos(angles) * apart[:, :1] + np.sin(angles) * apart[:, 1:2]
        return np.clip(-2.0 * towards, -5.0, 0.0)


controllers = [Pull(), find_policy("batd3-spatter-mujoco")]
cells = transfer(controllers, robot, ["mujoco", "pybullet"], ["spatter"], episodes=10)
print(format_table(cells))
