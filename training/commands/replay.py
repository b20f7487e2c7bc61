"""`cdcsr replay`: replay recorded commands in every engine."""

from __future__ import annotations

from pathlib import Path


def replay(
    dataset: Path,
    /,
    *,
    backend: str = "all",
    robot: str | None = None,
    frame_skip: int | None = None,
    json: Path | None = None,
) -> None:
    """Replay recorded commands open loop in each engine, and compare the paths of the tips.

    Args:
        dataset: a folder made by `cdcsr demonstrate`.
        backend: an engine, or all.
        robot: a shipped robot's name, or a path ending in .toml; by default the robot in the
            dataset, and the dataset must be of it.
        frame_skip: how many simulation steps each command was held for; by default the robot's own
            number.
        json: also write the distances to this file.
    """
    from cdcsr.errors import CdcsrError
    from cdcsr.files import write_json
    from cdcsr.robot.description import differences, load_robot
    from cdcsr.robot.ruler import ruler
    from cdcsr.simulation.engines import chosen_backends
    from controllers import demonstrations
    from controllers.dataset_files import stored_robot
    from controllers.replay import replay as run

    own = stored_robot(dataset)
    description = load_robot(robot or "paper") if robot or own is None else own
    if own is not None and own.fingerprint != description.fingerprint:
        raise CdcsrError(
            f"The demonstrations in {dataset} are of their own robot {own.name!r}, which differs "
            f"from {description.name!r} ({differences(own, description)}); leave --robot out."
        )
    frame_skip = ruler(description).frame_skip if frame_skip is None else frame_skip
    episodes = demonstrations.load(dataset, description.fingerprint, frame_skip, start="still")
    results = [
        run(description, name, episodes, frame_skip).as_dict()
        for name in chosen_backends(backend, description)
    ]
    print(
        f"{len(episodes)} recorded episodes, replayed without feedback; "
        "distance of the tip from the recording:"
    )
    for result in results:
        print(
            f"  {result['backend']:<10} mean {result['mean_mm']:.3f} mm, worst episode "
            f"{result['mean_of_worst_episode_mm']:.3f} mm, largest {result['largest_mm']:.3f} mm"
        )
    if json is not None:
        write_json(json, results)
