"""Makes rliable.json with the rliable package itself, which this project does not depend on.

python -m venv rliable && rliable/bin/pip install rliable==1.2.0 arch==7.2.0 "pandas<3"
rliable/bin/python tests/support/rliable_reference.py > tests/support/rliable.json
"""

import json
from importlib.metadata import version

import numpy as np
from rliable import library, metrics  # type: ignore[import-not-found]

SCORES = {
    "five runs of three tasks": [
        [0.31, 0.62, 0.90],
        [0.45, 0.70, 0.95],
        [0.05, 0.66, 0.99],
        [0.52, 0.41, 0.88],
        [0.38, 0.73, 0.97],
    ],
    "five runs of one task": [[0.31], [0.45], [0.05], [0.52], [0.38]],
}


def both(scores):
    """Mean and interquartile mean."""
    return np.array([metrics.aggregate_mean(scores), metrics.aggregate_iqm(scores)])


np.random.seed(0)  # rliable 1.2 draws from NumPy's global generator
cases = {name: np.array(scores) for name, scores in SCORES.items()}
points, intervals = library.get_interval_estimates(cases, both, reps=50_000)
reference = {
    name: {
        "scores": scores,
        "mean_iqm": points[name].tolist(),
        "low_high": intervals[name].tolist(),
    }
    for name, scores in SCORES.items()
}
print(
    json.dumps({"rliable": version("rliable"), "repetitions": 50_000, "cases": reference}, indent=2)
)
