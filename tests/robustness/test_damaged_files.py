"""Flip bits of every kind of file and cut files short: each loader refuses, in one line, what is
not the content that was written. `make test-all` does it 10,000 times, `make test` 300 times."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from cdcsr.errors import CdcsrError
from cdcsr.files import read_json, sealed, write_json
from cdcsr.robot.description import load_robot
from cdcsr.tables import csv_text, read_csv_rows
from cdcsr.tasks.workspace_map import Workspace, load_workspace
from controllers.dataset_files import stored_robot
from controllers.demonstrations import load
from tests.support.small_study import small_study
from tests.support.tiny import tiny_changes
from training.commands.demonstrate import demonstrate
from training.commands.search import SEARCH_FOLDER, _read_rows, _Row
from training.policy import load_policy
from training.run import trainer
from training.run.checkpoint import Parts, load_state, save_state
from training.run.metrics import read_metrics
from training.run.setup import Setup
from training.run.train_options import Train
from training.study.lines import read_lines
from training.study.parquet import read_table
from training.study.store import StoredRun, pack, read_results

ROBOT = load_robot("planar-single")
_STORE = (
    *("runs.jsonl", "learners.jsonl", "episodes.parquet", "metrics.parquet", "searches.jsonl"),
    *("searches.parquet", "SHA256SUMS"),
)
Load = Callable[[Path], object]


class Files:
    """A folder of files of every kind, made once, and what each loader reads from it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        demonstrate(out=folder / "set", episodes=1, frame_skip=10, robot="planar-single")
        self._map(folder / "map.npz")
        self.parts = self._stopped_run(folder / "run")
        self._study(folder)
        self.loaders: dict[str, tuple[tuple[str, ...], Load]] = {
            "dataset": (("set/data/main_data.hdf5", "set/data/metadata.json"), _dataset),
            "map": (("map.npz",), _map),
            "policy": (("run/policy.safetensors", "run/policy.json"), _policy),
            "metrics": (("run/metrics.csv",), lambda at: read_metrics(at / "run/metrics.csv")),
            "checkpoint": (("run/state.safetensors",), self._checkpoint),
            "record": (("run/config.json",), lambda at: read_json(at / "run/config.json")),
            "search": (("spatter/search.json", "spatter/targets.csv"), _search),
            "study": (("work/jacobian/run.json", "work/jacobian/nominal.csv"), _study),
            "store": (
                tuple(f"store/{name}" for name in _STORE),
                _store,
            ),
        }
        self.expected = {name: load(folder) for name, (_, load) in self.loaders.items()}

    def damaged(self, name: str, path: str, data: bytes) -> str:
        """Load a damaged file; return "refused", or "same" if the content is what it was."""
        place = self.folder / path
        whole = place.read_bytes()
        try:
            place.write_bytes(data)
            found = self.loaders[name][1](self.folder)
        except CdcsrError:  # which makes one line of any text, and cuts a long one
            return "refused"
        finally:
            place.write_bytes(whole)
        assert found == self.expected[name], f"{path} was accepted with other content"
        return "same"

    def _map(self, path: Path) -> None:
        cells = np.array([[0, 0, 0], [0, 0, 1]], dtype=np.int16)
        corner, edges = np.array(ROBOT.workspace.center), np.array([0.02, 0.0, 0.02])
        Workspace(ROBOT.fingerprint, corner, edges, cells, ROBOT.to_toml()).save(path)

    def _stopped_run(self, folder: Path) -> Parts:
        run = Train(
            out=folder,
            demonstrations=self.folder / "set",
            robot="planar-single",
            algorithm="td3",
            changes=tiny_changes("td3", capacity=200),
            frame_skip=10,
            updates=3,
            evaluate_episodes=1,
            stop_after=0.0,
        )
        trainer.train(run)
        setup = Setup(run)
        kind = trainer.find_algorithm("td3").learner
        assert kind is not None
        return trainer.Run(setup)._parts(kind, setup.learner, None)[0]  # type: ignore[arg-type]

    def _checkpoint(self, folder: Path) -> object:
        """Return the bytes that the parts write once they are put back to the state."""
        counters = load_state(folder / "run/state.safetensors", self.parts)
        again = folder / "again.safetensors"
        save_state(again, self.parts, counters)
        return again.read_bytes()

    def _study(self, folder: Path) -> None:
        work = small_study(folder / "work")
        for path in work.glob("*/*.csv"):
            path.write_text(csv_text(*read_csv_rows(path)))
        for path in work.glob("*/run.json"):
            write_json(path, sealed(read_json(path)))
        with SEARCH_FOLDER.claim(folder / "spatter", {"controller": "c", "rounds": 3}):
            row = [0, 0.1, 0.2, 2.4, 1.0, 99.0, 0.01, 1.0, 88.0, 0.02]
            (folder / "spatter/targets.csv").write_text(csv_text(_Row._fields, [row]))
        shutil.copytree(folder / "spatter", work / "spatter")
        pack(work, folder / "store")
        shutil.rmtree(work / "spatter")


def _dataset(folder: Path) -> object:
    (episode,) = load(folder / "set", ROBOT.fingerprint, 10)
    arrays = episode.observations, episode.actions, episode.rewards
    return [array.tobytes() for array in arrays], stored_robot(folder / "set")


def _map(folder: Path) -> object:
    found = load_workspace(ROBOT, folder / "map.npz")
    arrays = found.origin, found.edges, found.cells
    return [array.tobytes() for array in arrays], found.robot, found.description


def _policy(folder: Path) -> object:
    found = load_policy(folder / "run")
    return found.digest, found.card, found.robot, found.centers.tolist()


def _search(folder: Path) -> object:
    rows = _read_rows(folder / "spatter/targets.csv", np.array([[0.1, 0.2, 2.4]]))
    return read_json(folder / "spatter/search.json"), rows


def _study(folder: Path) -> object:
    return _plain(read_results(folder / "work"))


def _store(folder: Path) -> object:
    searches = read_table(folder / "store/searches.parquet")
    lines = read_lines(folder / "store/searches.jsonl")
    columns = {name: values.tolist() for name, values in searches.items()}
    return _plain(read_results(folder / "store")), columns, lines


def _plain(runs: dict[str, StoredRun]) -> object:
    return {
        name: (
            run.record,
            {key: values.tolist() for key, values in run.metrics.items()},
            {
                one: {key: values.tolist() for key, values in columns.items()}
                for one, columns in run.evaluations.items()
            },
        )
        for name, run in runs.items()
    }


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Files:
    torch.set_num_threads(1)
    return Files(tmp_path_factory.mktemp("files"))


@pytest.mark.parametrize(
    "times", [300, pytest.param(10_000, marks=pytest.mark.slow)], ids=["fast", "full"]
)
def test_no_loader_takes_other_content_or_fails_in_another_way(files: Files, times: int) -> None:
    rng = np.random.default_rng(times)
    found: Counter[tuple[str, str]] = Counter()
    targets = [(name, path) for name, (paths, _) in files.loaders.items() for path in paths]
    for trial in range(times):
        name, path = targets[trial % len(targets)]
        data = bytearray((files.folder / path).read_bytes())
        if rng.random() < 0.25:
            del data[int(rng.integers(len(data))) :]
        else:
            data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
        found[name, files.damaged(name, path, bytes(data))] += 1
    for (name, how), count in sorted(found.items()):
        print(f"{name:<11} {how:<8} {count}")
    assert sum(found.values()) == times
    refused = sum(count for (_, how), count in found.items() if how == "refused")
    assert refused > 0.9 * times  # a byte that means nothing, such as a space, may be another one
