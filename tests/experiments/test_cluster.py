"""Laws of the cluster: the same bytes from any workers, also when one is lost; what is no cluster
costs one line."""

import dataclasses
import os
import signal
import socket

import distributed
import jax
import numpy as np
import pytest
from spoken import leave_out_waits

from jaxtube.experiments.cli import main
from jaxtube.experiments.montecarlo import command
from jaxtube.experiments.run import cluster as clusters
from jaxtube.experiments.run.cluster import Cluster, Job
from jaxtube.statistics.montecarlo import make_closed_loop_task
from jaxtube.statistics.run import BLOCK, Run

pytest.importorskip("distributed")

OVERRIDES = ("reference.duration_s=3", "slip.relative_error=0.2", "noise.lateral_m=0.002")
WORDS = ("montecarlo", "--scenario", "robust", "--controller", "equal_gain", *OVERRIDES)


@pytest.fixture(scope="module")
def design(uncertified):
    return uncertified("robust", *OVERRIDES)


@pytest.fixture
def known(monkeypatch, design):
    monkeypatch.setattr(
        command, "make_design", lambda scenario, options: dataclasses.replace(design)
    )
    monkeypatch.setattr("jaxtube.experiments.montecarlo.figures.draw", lambda *arguments: None)
    monkeypatch.setattr(clusters, "SECONDS_TO_CONNECT", 1)


@pytest.fixture
def local(design):
    task = make_closed_loop_task(design, "equal_gain", "robot", "scenario", None, 3)
    return Run(task, 20 * BLOCK - 5, 1, (jax.devices()[0],))


def as_bytes(found):
    return {
        block: {name: value.tobytes() for name, value in statistics.items()}
        for block, statistics in found
    }


@pytest.mark.parametrize(
    "name", ["nonsense", "tcp://127.0.0.1:1", "local:two", "local:0", "local:-1"]
)
def test_what_is_no_cluster_costs_one_line(known, tmp_path, capsys, name):
    assert (
        main([*WORDS, "--realisations", "10", "--out", str(tmp_path / "run"), "--cluster", name])
        == 2
    )
    output = capsys.readouterr()
    lines = leave_out_waits(output.err)
    assert (
        len(lines) == 1
        and lines[0].startswith(f'command line: --cluster = "{name}": ')
        and not output.out
    )
    assert "local:N" in lines[0]
    with pytest.raises(
        ValueError, match="No clients found"
    ):  # no broken one is left for others to find
        distributed.default_client()


def test_an_address_that_answers_but_is_no_scheduler_costs_one_line(known, tmp_path, capsys):
    with socket.create_server(("127.0.0.1", 0)) as silent:
        name = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        words = [*WORDS, "--realisations", "10", "--out", str(tmp_path / "run")]
        assert main([*words, "--cluster", name]) == 2
    [line] = leave_out_waits(capsys.readouterr().err)
    assert line.startswith(f'command line: --cluster = "{name}": cannot be reached (TimeoutError)')


def test_a_job_is_the_run_as_plain_arrays(local):
    """What travels loses no bit of the task, and names no device."""
    job = Job.from_run(local, pinned=False)
    assert all(isinstance(leaf, np.ndarray) for leaf in jax.tree.leaves(job.task))
    again = job.make_run(jax.devices()[0])
    assert again.realisations == local.realisations and again.at_once == 1
    for one, other in zip(jax.tree.leaves(local.task), jax.tree.leaves(again.task), strict=True):
        if one is local.task.seed_key:
            one = jax.random.key_data(one)
            other = jax.random.key_data(other)
        one = np.asarray(one)
        other = np.asarray(other)
        assert (
            one.dtype == other.dtype
            and one.shape == other.shape
            and one.tobytes() == other.tobytes()
        )


@pytest.mark.slow
def test_the_workers_of_this_machine_give_the_same_bytes(known, tmp_path):
    words = [*WORDS, "--realisations", str(5 * BLOCK + 7), "--starts", "feasible"]
    assert main([*words, "--out", str(tmp_path / "alone")]) == 0
    assert main([*words, "--out", str(tmp_path / "cluster"), "--cluster", "local:2"]) == 0
    for name in ("statistics.npz", "metrics.json"):
        assert (tmp_path / "alone" / name).read_bytes() == (
            tmp_path / "cluster" / name
        ).read_bytes()


@pytest.mark.slow
def test_a_lost_worker_costs_nothing(local):
    blocks = range(20)
    found = []
    with Cluster("local:2", local) as cluster:
        assert cluster.at_once == 2
        workers = sorted(cluster._client.run(os.getpid).values())
        for block, statistics in cluster.compute(blocks):
            if len(found) == 3:
                os.kill(workers[0], signal.SIGKILL)
            found.append((block, statistics))
        assert sorted(cluster._client.run(os.getpid).values()) != workers
    assert sorted(block for block, _ in found) == list(blocks)
    assert as_bytes(found) == as_bytes(local.compute(blocks))


@pytest.mark.slow
def test_workers_with_other_code_are_refused(local, monkeypatch):
    monkeypatch.setattr(clusters, "source_hashes", lambda: {"jaxtube": "other"})
    refused = pytest.raises(
        ValueError,
        match="has another version of jaxtube or jax, or other devices; install the same",
    )
    with Cluster("local:1", local) as cluster, refused:
        next(cluster.compute([0]))
