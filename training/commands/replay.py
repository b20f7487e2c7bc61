"""`cdcsr replay`: replay recorded commands in every engine."""

from __future__ import annotations

from pathlib import Path


def replay(
    dataset: Path,
    /,
    *,
    backend: str = "all",
    robot: str = "paper",
    frame_skip: int = 1,
    json: Path | None = None,
) -> None:
    """Replay recorded commands open loop in each engine, and compare the paths of the tips.

    Args:
        dataset: a folder made by `cdcsr demonstrate`.
        backend: an engine, or all.
        robot: the robot of the dataset: a shipped robot's name, or a path ending in .toml.
        frame_skip: how many simulation steps each command was held for.
        json: also write the distances to this file.
    """
    from cdcsr.files import write_json
    from cdcsr.robot.description import load_robot
    from cdcsr.simulation.engines import chosen_backends
    from controllers import demonstrations
    from controllers.replay import replay as run

    description = load_robot(robot)
    episodes = demonstrations.load(dataset, description.fingerprint, frame_skip, start="still")
    results = [
        run(description, name, episodes, frame_skip).as_dict() for name in chosen_backends(backend)
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
