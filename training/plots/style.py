"""Titles of algorithms."""

from __future__ import annotations

ALGORITHMS = {
    "bc": "BC",
    "batd3": "BATD3",
    "clasp": "CLASP (ours)",
    "td3wd": "TD3wD",
    "rbl": "RBL",
    "td3": "TD3",
    "her": "TD3+HER",
    "rlpd": "RLPD",
    "drldr": "DRLDR",
    "batd3-no-bc": "BATD3 without BC assistance",
    "batd3-no-prefill": "BATD3 without pre-filled data",
    "batd3-no-ensemble": "BATD3 without ensemble",
    "jacobian": "demonstrator",
}
"""Titles of algorithms by their names, in the order tables list them."""


def algorithm_title(name: str) -> str:
    """An algorithm's name as it is written in text."""
    return ALGORITHMS.get(name, name)
