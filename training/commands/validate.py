"""`cdcsr validate`: hold a robot's physics against solutions from elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import Literal


def validate(
    what: Literal["cosserat"],  # noqa: ARG001 - it names the comparison
    folder: Path,
    /,
    *,
    material: Literal["steel", "tpu", "all"] = "all",
    links: tuple[int, ...] = (12, 13, 25, 50),
    shapes: int = 100,
    backend: str = "mujoco",
    json: Path | None = None,
) -> None:
    """Measure how far elastic rods made of links are from continuous (Cosserat) ones.

    The reference is the data of OpenCR-MuJoCo (arXiv 2606.22397), which its authors give away:
    shapes at rest of a clamped rod under gravity and wrenches at its middle and its tip.

    Args:
        what: what to hold the rods against; only "cosserat".
        folder: the data; it holds the folder `statics`.
        material: the rods of which material.
        links: the numbers of links to divide the rod into.
        shapes: how many shapes to compare, from the first one on.
        backend: the engine whose forces must balance.
        json: also write every number to this file.
    """
    from backends.cosserat.reference import MATERIALS, first, read_shapes
    from backends.cosserat.statics import fit
    from cdcsr.errors import CdcsrError
    from cdcsr.files import write_json
    from cdcsr.robot.physical_rules import MOST_LINKS
    from cdcsr.simulation.arguments import check_count

    check_count("shapes", shapes, 1_000_000)
    if not links:
        raise CdcsrError("No number of links is given; give some with --links.")
    for count in links:
        check_count("A number of links", count, MOST_LINKS)
    rows: list[dict[str, object]] = []
    print("material  links  shapes  tip error: mean    max  middle: mean   seconds a shape")
    for name in MATERIALS if material == "all" else (material,):
        known = first(read_shapes(folder, name), shapes)
        for count in links:
            found = fit(name, count, known, backend)
            tip, middle = 1e3 * found.tip_error, 1e3 * found.middle_error
            print(
                f"{name:8}  {count:5}  {len(tip):6}  {tip.mean():13.3f} mm {tip.max():6.3f}  "
                f"{middle.mean():12.3f}   {found.seconds:15.4f}"
            )
            rows.append(
                {
                    "material": name,
                    "backend": backend,
                    "links": count,
                    "seconds": found.seconds,
                    "tip_error": found.tip_error.tolist(),
                    "middle_error": found.middle_error.tolist(),
                }
            )
    if json is not None:
        write_json(json, rows)
