"""`cdcsr validate`: hold a robot's physics against solutions from elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from collections.abc import Sequence

    from backends.cosserat.reference import Release, Shapes
    from backends.cosserat.releases import Swing
    from backends.cosserat.statics import Fit

_RELEASED = 25
"""The number of links of a rod that is let go."""
_ORDERS = {"even": (6, 18, 54), "odd": (5, 15, 45)}
_ORDER_SHAPES = 20
_Moving = tuple["Release", "Swing", "Swing"]


def validate(
    what: Literal["cosserat"],  # noqa: ARG001 - it names the comparison
    folder: Path,
    /,
    *,
    material: Literal["steel", "tpu", "all"] = "all",
    links: tuple[int, ...] = (12, 13, 25, 50),
    shapes: int = 100,
    backend: str = "mujoco",
    plot: Path | None = None,
    json: Path | None = None,
) -> None:
    """Measure how far elastic rods made of links are from continuous (Cosserat) ones.

    The reference is the data of OpenCR-MuJoCo (arXiv 2606.22397), which its authors give away:
    shapes at rest of a clamped rod under gravity and wrenches at its middle and its tip, and rods
    that are let go. Rods that are let go have 25 links. They are compared with a stack of links,
    which has its joints at the start of equal cells, in MuJoCo with nothing added.

    Args:
        what: what to hold the rods against; only "cosserat".
        folder: the data; it holds the folders `statics` and, for releases, `dynamics`.
        material: the rods of which material.
        links: the numbers of links to divide the rod into.
        shapes: how many shapes to compare, from the first one on; there are 500 of each material.
        backend: the engine whose forces must balance, and in which rods move.
        plot: also draw the results to this PNG.
        json: also write every number to this file.
    """
    from backends.cosserat.reference import MATERIALS, first, read_shapes
    from cdcsr.errors import CdcsrError
    from cdcsr.files import write_json
    from cdcsr.simulation.arguments import check_count

    check_count("The number of shapes", shapes, 500)
    for count in links:
        check_count("A number of links", count, 500)
    if not links:
        raise CdcsrError("Give at least one number of links, as in --links 12 25.")
    chosen = MATERIALS if material == "all" else (material,)
    known = {name: first(read_shapes(folder, name), shapes) for name in chosen}
    fits = {name: _rests(name, links, known[name], backend) for name in chosen}
    orders = {name: _orders(name, first(known[name], _ORDER_SHAPES)) for name in chosen}
    moving = {name: _releases(name, folder, backend) for name in chosen}
    if plot is not None:
        from backends.cosserat.plots import draw

        every = [one for found in moving.values() for one in found]
        draw(fits, every[-1] if every else None, plot)
    if json is not None:
        write_json(json, [_row(name, backend, fits, orders, moving) for name in chosen])


def _rests(name: str, links: Sequence[int], known: Shapes, backend: str) -> list[Fit]:
    """Measure and print the shapes at rest."""
    from backends.cosserat.statics import fit

    print("material  links  shapes  tip error: mean    max  middle: mean   seconds a shape")
    fits = []
    for count in links:
        found = fit(name, count, known, backend)
        fits.append(found)
        tip, middle = 1e3 * found.tip_error, 1e3 * found.middle_error
        print(
            f"{name:8}  {count:5}  {len(tip):6}  {tip.mean():13.3f} mm {tip.max():6.3f}  "
            f"{middle.mean():12.3f}   {found.seconds:15.4f}"
        )
    return fits


def _orders(name: str, known: Shapes) -> dict[str, float]:
    """Measure and print the order in the number of links, which depends on no engine."""
    from backends.cosserat.statics import order

    found = {kind: order(name, counts, known, "mujoco") for kind, counts in _ORDERS.items()}
    text = ", ".join(f"{value:.2f} for {kind} numbers of links" for kind, value in found.items())
    print(f"{name:8}  order of the tip error: {text}")
    return found


def _releases(name: str, folder: Path, backend: str) -> list[_Moving]:
    """Measure and print rods that are let go; the folder may hold none."""
    from backends.cosserat.reference import count_releases, read_release, rod, stacked_rod
    from backends.cosserat.releases import STACKED, swings

    releases = [read_release(folder, name, n + 1) for n in range(count_releases(folder, name))]
    if not releases:
        print(f"{name:8}  no releases in {folder}")
        return []
    ours = swings(releases, rod(name, _RELEASED), backend)
    stacked = swings(releases, stacked_rod(name, _RELEASED), STACKED)
    for label, found in ((backend, ours), (f"stack of links in {STACKED}", stacked)):
        rms = [1e3 * each.rms for each in found]
        print(
            f"{name:8}  {len(rms)} releases, {_RELEASED} links, root mean square tip distance: "
            f"mean {sum(rms) / len(rms):.3f} mm, max {max(rms):.3f} mm ({label})"
        )
    return list(zip(releases, ours, stacked, strict=True))


def _row(
    name: str,
    backend: str,
    fits: dict[str, list[Fit]],
    orders: dict[str, dict[str, float]],
    moving: dict[str, list[_Moving]],
) -> dict[str, object]:
    """Return the numbers of a material, ready for JSON, in [m] and [s]."""
    return {
        "material": name,
        "backend": backend,
        "rests": [
            {
                "links": found.links,
                "seconds": found.seconds,
                "tip_error": found.tip_error.tolist(),
                "middle_error": found.middle_error.tolist(),
            }
            for found in fits[name]
        ],
        "orders": orders[name],
        "releases": [
            {"links": _RELEASED, "rms": ours.rms, "stacked_rms": stacked.rms}
            for _, ours, stacked in moving[name]
        ],
    }
