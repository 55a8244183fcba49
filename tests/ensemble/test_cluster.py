"""Many runs on a real Dask cluster of separate processes, which are killed in the middle."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading

import pytest

from stickslip.ensemble import pool, reach, run_members
from stickslip.ensemble.pool import connect
from stickslip.runs.sweep.dataset import open_sweep
from stickslip.runs.sweep.run import run_sweep
from tests.ensemble import tasks
from tests.ensemble.test_ensemble import ended, until
from tests.ensemble.test_sweep import small

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")


def test_results_and_words_come_from_the_cluster(cluster):
    said = []
    found = run_members(
        tasks.square, [(k,) for k in range(5)], workers=cluster.address, report=lambda *now: said.append(now[2])
    )
    assert [m.result for m in found] == [0, 1, 4, 9, 16]
    assert any(text.endswith("; square of 0: half") for text in said)
    assert "the Dask cluster at tcp://127.0.0.1" in reach(cluster.address).words


def test_words_come_from_every_member(cluster):
    """Also from those that begin after the first one has ended."""
    said = []
    run_members(
        tasks.linger, [(k,) for k in range(4)], workers=cluster.address, report=lambda *now: said.append(now[2])
    )
    assert any(text.endswith("; wait of 3: half") for text in said)


def test_the_dataset_of_a_sweep_does_not_depend_on_how_members_were_run(tmp_path, cluster):
    found = []
    for k, workers in enumerate((1, 2, cluster.address)):
        run_sweep(small(), tmp_path / str(k), workers=workers)
        found.append(open_sweep(tmp_path / str(k)).drop_vars("seconds"))
    assert found[0].identical(found[1])
    assert found[0].identical(found[2])


def test_a_client_will_do(cluster):
    from distributed import Client

    with Client(scheduler_file=cluster.address, set_as_default=False) as client:
        found = run_members(tasks.fail_at, [(k, 2) for k in range(4)], workers=client)
        assert client.status == "running"
    assert [m.result for m in found] == [0, 1, None, 3]
    assert found[2].failure == "2 is bad"


def test_a_member_that_always_dies_costs_only_itself(cluster, tmp_path):
    found = run_members(tasks.die, [(k, str(tmp_path), 99) for k in range(6)], workers=cluster.address)
    assert [m.result for m in found] == [0, 1, 4, None, 16, 25]
    assert found[3].failure == "worker died (killed, or out of memory), 2 times"


def test_a_killed_worker_costs_nothing_while_another_is_left(cluster, tmp_path):
    workers, killed = {process.pid: process for process in cluster.processes[1:]}, []

    def kill():
        until(lambda: (tmp_path / "pid0").exists() and len((tmp_path / "pid0").read_text().split()) == 2)
        helper, worker = map(int, (tmp_path / "pid0").read_text().split())
        assert worker in workers
        os.kill(worker, signal.SIGKILL)
        killed.extend([worker, until(lambda: ended(helper), 5)])

    killer = threading.Thread(target=kill)
    killer.start()
    found = run_members(tasks.wait, [(str(tmp_path), k, 1.0) for k in range(4)], workers=cluster.address)
    killer.join()
    cluster.worker()  # the next test has two again
    assert [m.result for m in found] == [0, 1, 2, 3]
    assert killed[1], "the killed worker's own process went on"
    assert workers[killed[0]].wait() == -signal.SIGKILL


@pytest.fixture(scope="module")
def lonely(scheduler):
    """A cluster whose only worker started after members had been sent to it, these members, and what was said."""
    said = []

    def report(stage, share, text):
        if not said:
            scheduler.worker()
        said.append(text)

    return scheduler, run_members(tasks.square, [(3,), (4,)], workers=scheduler.address, report=report), said


def test_a_cluster_without_workers_is_waited_for_and_that_is_said(lonely):
    _, found, said = lonely
    assert [m.result for m in found] == [9, 16]
    assert said[0] == "0 of 2; the cluster: no workers yet, waiting for the first"


def test_a_scheduler_that_is_gone_is_one_sentence(lonely, tmp_path):
    scheduler, *_ = lonely

    def report(stage, share, text):
        if "started" in text:
            scheduler.scheduler.kill()

    with pytest.raises(
        RuntimeError, match=r"the Dask scheduler has disappeared.*; 4 of 5 members did not finish"
    ) as caught:
        tasks_of_all = [(str(tmp_path), k, 60) for k in range(5)]
        run_members(
            tasks.wait, tasks_of_all, workers=scheduler.address, report=report,
            load=lambda k: "before" if k == 3 else None,
        )  # fmt: skip
    assert "\n" not in str(caught.value)


def test_members_end_when_their_client_is_killed(cluster, tmp_path):
    code = f"from stickslip.ensemble import run_members as r; from tests.ensemble.tasks import wait; \
        r(wait, [({str(tmp_path)!r}, 0, 60)], workers={cluster.address!r})"
    client = subprocess.Popen([sys.executable, "-c", code], env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)})
    assert until(lambda: (tmp_path / "pid0").exists() and (tmp_path / "pid0").read_text())
    helper = int((tmp_path / "pid0").read_text().split()[0])
    assert not ended(helper)
    client.kill()
    client.wait()
    assert until(lambda: ended(helper), 10)


@pytest.mark.slow
def test_a_kernel_that_keeps_the_interpreter_does_not_cost_the_worker(cluster):
    """The scheduler of this cluster gives a silent worker up after 5 s; that of a user after five minutes."""
    found = run_members(tasks.hold, [(15,), (15,)], workers=cluster.address)
    assert [m.result for m in found] == [15, 15]
    assert reach(cluster.address).slots == 2


@pytest.mark.parametrize("says", [b"", b"HTTP/1.0 400 Bad Request\r\n\r\n"], ids=["mute", "http"])
def test_a_port_at_which_somebody_else_listens_is_given_up(monkeypatch, says):
    monkeypatch.setattr(pool, "PATIENCE", 0.3)
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer():
            with contextlib.suppress(OSError):
                while True:
                    one, _ = server.accept()
                    held.append(one)
                    if says:
                        one.sendall(says)

        held = []
        threading.Thread(target=answer, daemon=True).start()
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(ValueError, match="no Dask scheduler answers at") as caught:
            reach(address)
    assert "\n" not in str(caught.value)


def test_a_protocol_of_no_scheduler_is_refused():
    with pytest.raises(ValueError, match="its protocol is http, not tcp"):
        reach("http://127.0.0.1:8786")


# 3 s: Dask is imported for the first time
def test_a_scheduler_file_that_is_still_being_written_is_waited_for(tmp_path):
    path = tmp_path / "scheduler.json"
    path.write_text('{"address": ', encoding="utf-8")
    timer = threading.Timer(0.25, path.write_text, ['{"address": "tcp://127.0.0.1:1"}'])
    timer.start()
    with pytest.raises(ValueError, match=r"no Dask scheduler answers.*refused"), connect(str(path)):
        pass
