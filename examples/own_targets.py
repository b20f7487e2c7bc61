"""Draw targets where you want them: here on a ring around the arm, reached by the demonstrator.

python examples/own_targets.py
"""

import numpy as np

from cdcsr.envs.gym_env import TaskVectorEnv
from controllers.jacobian import JacobianController
from controllers.rollout import rollout


class Ring:
    """Targets on a circle around the arm's axis; anything with `name` and `sample` is a space."""

    name = "ring"

    def sample(self, rng: np.random.Generator, num: int) -> np.ndarray:
        angle = rng.uniform(0, 2 * np.pi, num)
        return np.stack([0.25 * np.cos(angle), 0.25 * np.sin(angle), np.full(num, 2.5)], axis=1)


env = TaskVectorEnv(12, "paper", "mujoco", autoreset_mode="Disabled")
env.space = Ring()
observation, _ = env.reset(seed=0)
done = rollout(JacobianController(env.robot), env, observation)
print(f"{done.success.sum()} of {env.num_envs} targets on the ring were reached")
env.close()
