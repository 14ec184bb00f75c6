"""A set built on a real cluster is that of one process, though a worker is killed meanwhile."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from feel321.jobs import Workers, run_jobs
from feel321.stimuli.sets.build import build_stimuli
from feel321.stimuli.synthesis import SCENES, make_scene
from feel321.study.study import Study
from tests.cluster.conftest import Cluster

SOME: dict[str, Any] = {
    "reducers": ("sax321", "dft321", "mag321"), "levels": ("as_is", "equal_intensity"),
}  # fmt: skip


def contents(folder: Path) -> dict[str, bytes]:
    """Every file of a set, the manifest too."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != ".lock"
    }


def build(
    folder: Path, workers: Workers, then: Callable[[], object] = lambda: None
) -> dict[str, bytes]:
    """Build a set; then: what happens when the first job is done."""

    def follow(done: int, _total: int) -> None:
        if done == 1:
            then()

    scenes = [make_scene(name, duration_s=0.5) for name in SCENES]
    build_stimuli(scenes, folder, workers=workers, progress=follow, **SOME)
    return contents(folder)


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The set that one process builds."""
    return build(tmp_path_factory.mktemp("alone"), Workers())


def test_a_worker_killed_midway_changes_no_byte(
    tmp_path: Path, cluster: Cluster, alone: dict[str, bytes]
) -> None:
    first = cluster.start_worker()
    cluster.start_worker()
    assert build(tmp_path, Workers(1, cluster.address), then=first.kill) == alone
    assert first.wait() == -signal.SIGKILL


@pytest.mark.soak
def test_two_processes_give_the_same_bytes(tmp_path: Path, alone: dict[str, bytes]) -> None:
    assert build(tmp_path, Workers(2)) == alone


@pytest.mark.soak
def test_ctrl_c_leaves_nothing_half_written(
    tmp_path: Path, cluster: Cluster, alone: dict[str, bytes]
) -> None:
    cluster.start_worker()

    def interrupt() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build(tmp_path, Workers(1, cluster.address), then=interrupt)
    assert not [*tmp_path.glob("manifest.csv")]
    assert build(tmp_path, Workers(1, cluster.address)) == alone


@pytest.mark.soak
def test_a_bundled_study_is_built_by_a_cluster_as_by_one_process(
    tmp_path: Path, cluster: Cluster
) -> None:
    cluster.start_worker()
    cluster.start_worker()
    Study.create(tmp_path / "there")
    Study.create(tmp_path / "here").build()
    command = "import sys; from feel321.study.cli import main; sys.exit(main(sys.argv[1:]))"
    words = [sys.executable, "-W", "error", "-c", command, "build", "there"]
    done = subprocess.run(
        [*words, "--scheduler", cluster.address], cwd=tmp_path, capture_output=True, text=True,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"}, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    here, there = (contents(tmp_path / name / "stimuli") for name in ("here", "there"))
    assert here == there
    assert "manifest.csv" in here


@pytest.mark.soak
def test_what_goes_wrong_there_is_said_here(tmp_path: Path, cluster: Cluster) -> None:
    other = tmp_path / "other_version.py"
    other.write_text("import feel321\n\nfeel321.__version__ = '0.0.1'\n", encoding="utf-8")
    late = cluster.start_worker("--preload", str(other))
    workers = Workers(1, cluster.address)
    with pytest.raises(ValueError, match=r"a worker has feel321 0\.0\.1 instead of "):
        build(tmp_path / "set", workers)
    late.kill()
    late.wait()
    cluster.start_worker()
    with pytest.raises(ValueError, match="fade"):
        build_stimuli([make_scene("bumps")], tmp_path / "set", fade_s=5.0, workers=workers)
    for _ in range(4):
        cluster.start_worker()
    with pytest.raises(OSError, match=r"the Dask cluster failed "):
        [*run_jobs([(signal.raise_signal, (signal.SIGKILL,), {})], workers=workers)]
