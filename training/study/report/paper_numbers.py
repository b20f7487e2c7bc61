"""The numbers that the paper prints (Tian et al., BATD3), Tables II to IV."""

from __future__ import annotations

from training.study.report.cells import Spread

Printed = tuple[float, Spread]
"""Success rate kappa, and episode length l_epi (mean and deviation) in simulation steps."""


def _row(*numbers: tuple[float, float, float]) -> list[Printed]:
    return [(kappa, Spread(mean, std)) for kappa, mean, std in numbers]


_SPACES = ("anchor", "floating", "spatter")
_FAILS = (0.0, 250.0, 0.0)

TABLE_2: dict[tuple[str, str], Printed] = {
    (algorithm, space): printed
    for algorithm, row in {
        "bc": _row((0.54, 179.4, 67.3), (0.37, 203.1, 64.3), (0.25, 216.6, 61.0)),
        "batd3": _row((0.76, 144.6, 63.2), (0.79, 135.8, 63.7), (0.65, 151.5, 74.6)),
        "td3wd": _row((0.37, 194.2, 73.7), (0.31, 210.6, 63.3), (0.37, 195.3, 71.9)),
        "rbl": _row((0.26, 215.5, 59.8), (0.32, 204.8, 67.3), (0.35, 204.1, 65.2)),
        "td3": _row(_FAILS, _FAILS, _FAILS),
        "her": _row(_FAILS, _FAILS, _FAILS),
        "rlpd": _row((0.34, 210.9, 59.8), (0.31, 211.8, 59.6), (0.16, 227.6, 54.1)),
    }.items()
    for space, printed in zip(_SPACES, row, strict=True)
}
"""By algorithm and space."""

TABLE_3: dict[tuple[str, str], Printed] = {
    pair: (kappa, Spread(mean, std))
    for pair, (kappa, mean, std) in {
        ("anchor", "floating"): (0.49, 183.2, 70.6),
        ("anchor", "spatter"): (0.33, 200.4, 71.5),
        ("floating", "anchor"): (0.65, 156.1, 71.1),
        ("floating", "spatter"): (0.63, 152.4, 77.3),
        ("spatter", "anchor"): (0.65, 158.1, 70.0),
        ("spatter", "floating"): (0.67, 151.7, 71.1),
    }.items()
}
"""BATD3, by the space it was trained in and the one it was tested in."""

_UNDISTURBED = [TABLE_2["batd3", space] for space in _SPACES]
TABLE_4: dict[tuple[str, float, str], Printed] = {
    (axis, level, space): printed
    for axis, levels in {
        "action_noise": {
            0.5: _row((0.75, 148.2, 62.4), (0.79, 137.7, 62.8), (0.65, 153.5, 73.1)),
            1.0: _row((0.75, 151.5, 60.7), (0.77, 144.1, 62.7), (0.63, 159.4, 71.6)),
            1.5: _row((0.74, 155.9, 59.2), (0.72, 155.7, 62.8), (0.59, 168.5, 69.9)),
            2.0: _row((0.71, 165.3, 57.6), (0.70, 164.8, 60.7), (0.57, 172.7, 67.2)),
        },
        "base_noise": {
            0.01: _row((0.74, 147.1, 64.7), (0.76, 139.4, 66.6), (0.65, 153.0, 73.7)),
            0.02: _row((0.71, 151.0, 67.0), (0.70, 147.4, 70.9), (0.62, 156.5, 75.0)),
            0.03: _row((0.68, 155.2, 68.9), (0.67, 152.0, 72.6), (0.61, 161.2, 73.7)),
        },
        "packet_loss": {
            0.2: _row((0.76, 144.5, 63.2), (0.79, 135.9, 63.7), (0.65, 151.4, 74.7)),
            0.4: _row((0.76, 144.5, 63.3), (0.79, 136.2, 63.5), (0.65, 151.2, 74.8)),
            0.6: _row((0.75, 144.5, 64.3), (0.79, 136.4, 63.2), (0.64, 152.5, 75.3)),
            0.8: _row((0.75, 148.4, 63.4), (0.77, 143.0, 64.6), (0.62, 156.6, 75.0)),
            1.0: _row(_FAILS, _FAILS, _FAILS),
        },
    }.items()
    for level, row in {0.0: _UNDISTURBED, **levels}.items()
    for space, printed in zip(_SPACES, row, strict=True)
}
"""BATD3, by what disturbs, how much, and the space it was trained and tested in."""

DISTURBANCES = {"action_noise": "σ_a", "base_noise": "σ_b", "packet_loss": "p"}
"""The paper's letters for them."""
