"""A real Dask cluster: a scheduler and two workers, each a process that `dask` started."""

import os
import subprocess
import sys
import time

import pytest


class Cluster:
    """Processes of a scheduler and of workers, started one by one."""

    def __init__(self, folder):
        self.folder, self.file, self.processes = folder, folder / "scheduler.json", []
        self.scheduler = self._start("scheduler", "--port", "0", "--host", "127.0.0.1", "--scheduler-file", self.file)
        while not self.file.exists():
            assert self.scheduler.poll() is None, "the scheduler ended"
            time.sleep(0.05)

    @property
    def address(self) -> str:
        return str(self.file)

    def worker(self, *words):
        """One more worker, without a nanny: if it is killed, nobody starts it again."""
        where = ("--scheduler-file", self.file, "--nthreads", "1", "--no-nanny", "--local-directory", self.folder)
        return self._start("worker", *where, *words)

    def _start(self, *words):
        environment = os.environ | {
            "PYTHONPATH": os.pathsep.join(sys.path), "DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL": "5s",
        }  # fmt: skip
        command = [sys.executable, "-m", "dask", *map(str, words), "--no-dashboard"]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        self.processes.append(subprocess.Popen(command, env=environment, **quiet))
        return self.processes[-1]

    def end(self):
        for process in reversed(self.processes):
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory):
    """A cluster that has no workers yet."""
    pytest.importorskip("distributed")
    found = Cluster(tmp_path_factory.mktemp("scheduler"))
    yield found
    found.end()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """A cluster with two workers."""
    pytest.importorskip("distributed")
    found = Cluster(tmp_path_factory.mktemp("cluster"))
    for _ in range(2):
        found.worker()
    yield found
    found.end()
