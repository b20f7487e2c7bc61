"""The study on a Ray cluster of two nodes, one of which is lost on the way."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from cdcsr.errors import CdcsrError
from tests.support.tiny import TINY_BUDGET, tiny_job
from training.study.execute.jobs import Job
from training.study.execute.ray_executor import carry_out_on_ray

_JOB = replace(tiny_job(400), budget=replace(TINY_BUDGET, evaluate_every=50))


@pytest.fixture
def cluster() -> Iterator[Any]:
    pytest.importorskip("ray", reason="the extra ray is not installed")
    from ray.cluster_utils import Cluster  # type: ignore[import-not-found]

    made = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    yield made
    made.shutdown()


def _executor(jobs: list[Job], folder: Path, address: str) -> subprocess.Popen[str]:
    """Another process: Ray's own leaves sockets and warnings behind in this one."""
    code = (
        "import sys; from pathlib import Path; from training.study.execute.jobs import Job; "
        "from training.study.execute.ray_executor import carry_out_on_ray; "
        "jobs = [Job.from_json(j) for j in sys.argv[4:]];"
        "o = carry_out_on_ray(jobs, Path(sys.argv[1]), Path(sys.argv[2]),"
        " sys.argv[3]); print('failed', o.failed); sys.exit(bool(o.failed))"
    )
    folders = [str(folder / "runs"), str(folder / "results")]
    command = [sys.executable, "-c", code, *folders, address, *(job.to_json() for job in jobs)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def _ends(process: subprocess.Popen[str]) -> str:
    text, _ = process.communicate(timeout=500)
    assert process.returncode == 0, text
    return text


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # Ray's own
def test_a_lost_node_loses_nothing_and_nothing_runs_twice(tmp_path: Path, cluster: Any) -> None:
    second = cluster.add_node(num_cpus=1)
    cluster.wait_for_nodes()
    jobs = [replace(_JOB, spec=replace(_JOB.spec, seed=seed)) for seed in range(4)]
    runs, results = tmp_path / "runs", tmp_path / "results"
    process = _executor(jobs, tmp_path, cluster.address)
    # Once the first run is finished and two others have a checkpoint, a node dies.
    deadline = time.monotonic() + 400
    while not list(results.glob("*/run.json")) or len(list(runs.glob("*/state.safetensors"))) < 2:
        assert time.monotonic() < deadline
        assert process.poll() is None, process.communicate()
        time.sleep(0.05)
    finished = {path: path.stat().st_mtime_ns for path in results.glob("*/run.json")}
    held = {path.name: json.loads(path.read_text())["pid"] for path in runs.glob("*.lock")}
    cluster.remove_node(second, allow_graceful=False)
    assert "failed {}" in _ends(process)
    assert all(job.is_done(results) for job in jobs)
    assert all(path.stat().st_mtime_ns == before for path, before in finished.items())
    # Every run began once; that of the lost node was resumed from its checkpoint elsewhere.
    logs = [(runs / f"{job.name}.log").read_text() for job in jobs]
    points = [text.count("update ") for text in logs]
    begun = [text.count("Recording ") for text in logs]
    assert sorted(begun) == [1, 1, 1, 2], (begun, held)
    assert all(8 <= count <= 9 for count in points), (
        points
    )  # at most the point it was at is made again
    assert not list(runs.glob("*.lock"))
    # The same grid again: there is nothing to do.
    assert _ends(_executor(jobs, tmp_path, cluster.address)).count("done before") == 4
    assert all(path.stat().st_mtime_ns == before for path, before in finished.items())


def test_without_ray_or_without_a_cluster_one_line_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(CdcsrError, match=r"pip install 'cdcsr\[ray\]'"):
        carry_out_on_ray([_JOB], tmp_path / "runs", tmp_path / "results", None)
