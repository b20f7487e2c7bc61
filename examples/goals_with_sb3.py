"""Train TD3 with hindsight experience replay of stable-baselines3 on 16 robots at once.

pip install 'cdcsr[sb3]' && python examples/goals_with_sb3.py 200000
cdcsr transfer hindsight.zip jacobian
"""

import sys

import gymnasium
from stable_baselines3 import TD3, HerReplayBuffer

import cdcsr  # noqa: F401 (registers the environments)
from backends.sb3_env import BatchedVecEnv

steps = int(sys.argv[1])
envs = BatchedVecEnv(gymnasium.make_vec("cdcsr/ReachGoal-v0", num_envs=16, frame_skip=5))
model = TD3(
    "MultiInputPolicy",
    envs,
    replay_buffer_class=HerReplayBuffer,
    learning_starts=1_000,  # hindsight begins when the first episodes have ended
    seed=0,
)
model.learn(steps)
model.save("hindsight.zip")
print(f"hindsight.zip: {model.num_timesteps} steps")
