"""The files of a Minari dataset: their digests, and what is checked before they are opened."""

from __future__ import annotations

import hashlib
import json
import os
import re
from pathlib import Path

import gymnasium

from cdcsr.errors import CdcsrError
from cdcsr.files import JsonObject, note, read_json, write_json
from cdcsr.reading import check_file
from cdcsr.robot.description import Robot, load_robot, parse_robot
from cdcsr.robot.ruler import ruler
from cdcsr.tasks.catalogue import make_task

_DATA, _METADATA = "main_data.hdf5", "metadata.json"
_SEALED = (
    *("robot", "robot_fingerprint", "robot_description", "task", "backend", "space", "start"),
    *("frame_skip", "total_episodes", "total_steps", "data_digest"),
    *("env_spec", "observation_space", "action_space"),
)
"""The entries of the metadata that are read here; Minari may change the others."""
_USUAL = {
    **{"robot": "paper", "backend": "mujoco", "space": "anchor", "start": "still"},
    **dict.fromkeys(("frame_skip", "threshold", "max_steps", "motion")),
}
"""The arguments of an environment that say where episodes are from, as they are if left out."""
_KNOWN = {*_USUAL, "task", "render_mode", "camera"}
_MOST_BYTES = 1 << 33
"""The largest dataset, in bytes, as a file and unpacked."""


def dataset_id(folder: Path) -> str:
    """Return the id of a dataset as Minari wants it: letters, digits, - and _, then a version.

    Args:
        folder: where the dataset will be.

    Raises:
        CdcsrError: Minari looks for datasets there, and would fail at a folder of that name.
    """
    plain = re.sub(r"[^-_A-Za-z0-9]", "_", folder.name)
    name = plain if re.search(r"[-_A-Za-z0-9]-v\d+$", plain) else f"{plain}-v0"
    usual = Path.home() / ".minari" / "datasets" if "HOME" in os.environ else None
    root = os.environ.get("MINARI_DATASETS_PATH", usual)
    if root is None:
        return name
    # `Path.resolve` fails at links that run in a circle, of which others tell the user.
    place, above = (Path(os.path.realpath(path)) for path in (folder, root))
    if not place.is_relative_to(above):
        return name
    if name != folder.name:
        raise CdcsrError(
            f"Minari reads every folder in {root} and fails at the name {folder.name!r}; give "
            f"--out {folder.with_name(name)}, or another place."
        )
    return place.relative_to(above).as_posix()


def seal_dataset(folder: Path) -> None:
    """Write the digests of a dataset that is complete into its metadata."""
    path = folder / "data" / _METADATA
    data = read_json(path)
    data["data_digest"] = _file_digest(folder / "data" / _DATA)
    write_json(path, {**data, "digest": _digest(data)})


def read_metadata(folder: Path) -> JsonObject:
    """Return the metadata of a dataset, once its files are known to be whole.

    Raises:
        CdcsrError: a file is missing, damaged, too large, or refers to other files.
    """
    data_file = folder / "data" / _DATA
    try:
        check_file(data_file, _MOST_BYTES, "dataset")
        data = read_json(folder / "data" / _METADATA)
    except CdcsrError as error:
        raise no_demonstrations(folder, error) from None
    if "digest" not in data and "data_digest" not in data:
        note(
            f"{folder} is of an older version, or Minari has written it: it has no digests, and "
            "damage would not be seen."
        )
    elif data.get("digest") != _digest(data) or data.get("data_digest") != _file_digest(data_file):
        raise CdcsrError(
            f"The dataset {folder} is damaged: {_DATA} or {_METADATA} has not the digest that it "
            "had when it was recorded; copy it again, or record it again with `cdcsr demonstrate`."
        )
    _check_content(data_file)
    return data if "robot_fingerprint" in data else {**_origin(folder, data), **data}


def _origin(folder: Path, data: JsonObject) -> JsonObject:
    """Return where the episodes are from, of a dataset that Minari recorded in an environment of
    ours, or made by combining datasets.

    Minari keeps the environment's id and its arguments. Nothing that they name is run.

    Raises:
        CdcsrError: there is no such environment, or an argument makes its rewards, observations or
            robots others than those of the task.
    """
    try:
        spec = json.loads(data["env_spec"])
        kind = gymnasium.registry[spec["id"]]
        if kind.namespace != "cdcsr" or not str(kind.entry_point).endswith(":TaskEnv"):
            raise ValueError(f"its environment {spec['id']} has not the observations of eq. (1)")
        options = {**_USUAL, **kind.kwargs, **spec["kwargs"]}
        others = [name for name in options if name not in _KNOWN and options[name] is not None]
        if others:
            raise ValueError(f"its environment was made with {', '.join(map(str, others))}")
        robot = load_robot(options["robot"])
        if options["frame_skip"] is None:
            options["frame_skip"] = ruler(robot).frame_skip
        task = make_task(
            options["task"],
            robot,
            max_steps=options["max_steps"],
            threshold=options["threshold"],
            motion=options["motion"],
            period=robot.time_step * options["frame_skip"],
        )
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise no_demonstrations(folder, error) from None
    found = {name: options[name] for name in ("backend", "space", "start", "frame_skip")}
    texts = {"robot": robot.name, "robot_description": robot.to_toml(), "task": task.name}
    return {
        **found,
        **texts,
        "robot_fingerprint": robot.fingerprint,
        "threshold": task.threshold,
    }


def no_demonstrations(folder: Path, error: Exception) -> CdcsrError:
    """Return the error for a folder that is no dataset of ours."""
    return CdcsrError(
        f"{folder} holds no demonstrations made by `cdcsr demonstrate`, or by Minari in an "
        f"environment of cdcsr: {error}"
    )


def stored_robot(folder: Path) -> Robot | None:
    """Return the robot of a dataset; None if it is of an older version, which has only its name.

    Raises:
        CdcsrError: the dataset is damaged, or the robot is not the one of its fingerprint.
    """
    data = read_metadata(folder)
    text, fingerprint = data.get("robot_description"), data.get("robot_fingerprint")
    if text is None:
        return None
    robot = parse_robot(str(text), f"The robot of {folder}")
    if robot.fingerprint != fingerprint:
        raise CdcsrError(
            f"The robot in {folder} has the fingerprint {robot.fingerprint}, but the demonstrations"
            f" are of {fingerprint}; record them again with `cdcsr demonstrate`."
        )
    return robot


def _check_content(path: Path) -> None:
    """Check that nothing in an HDF5 file lies in another file or unpacks to too much.

    Raises:
        CdcsrError: something does.
        OSError: it is no HDF5 file.
    """
    import h5py

    total = 0
    with h5py.File(path, "r") as file:
        waiting: list[h5py.Group] = [file]
        while waiting:
            group = waiting.pop()
            for name in group:
                if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                    raise CdcsrError(f"{path}: {name!r} is a link to elsewhere; copy its data.")
                item = group[name]
                if isinstance(item, h5py.Group):
                    waiting.append(item)
                elif isinstance(item, h5py.Dataset):
                    if item.external or item.is_virtual:
                        raise CdcsrError(f"{path}: the data of {name!r} lie in another file.")
                    total += int(item.size or 0) * item.dtype.itemsize
                if total > _MOST_BYTES:
                    raise CdcsrError(f"{path} unpacks to more than {_MOST_BYTES:,} bytes.")


def _digest(data: JsonObject) -> str:
    entries = {name: data.get(name) for name in _SEALED}
    return hashlib.sha256(json.dumps(entries, sort_keys=True).encode()).hexdigest()[:16]


def _file_digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:16]
