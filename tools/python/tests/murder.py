"""Convert on a cluster whose processes are killed: `python murder.py workers|scheduler RUNS`.

Prints one line per run and fails if bytes differ or files are left behind. `.ci/long cluster` runs the long forms.
"""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import cloudpickle

import slicewalk
import slicewalk.cluster
import tiles

SHARE = 0.3


def whole(folder: Path) -> list[Path]:
    inputs = tiles.tiles(folder)
    slicewalk.convert(inputs, folder / "single.slices", **tiles.OPTIONS)
    return inputs


def judge(folder: Path) -> None:
    assert (folder / "out.slices").read_bytes() == (folder / "single.slices").read_bytes(), "other bytes"
    assert tiles.leftovers(folder) == [], tiles.leftovers(folder)
    (folder / "out.slices").unlink()


def workers(runs: int, seed: int = 1) -> None:
    """Kill the workers of 30 % of the steps by SIGKILL, on four worker processes.

    A nanny gives up on a worker that dies before the nanny knows about it, which happens on machines with few cores.
    `replace` then starts another one, as a cluster manager would.
    """
    import dask
    from distributed import Client, LocalCluster

    dask.config.set({"distributed.deploy.lost-worker-timeout": "2s"})
    ended = threading.Event()

    def replace(cluster: LocalCluster) -> None:
        while not ended.wait(1):
            cluster.scale(4)

    cloudpickle.register_pickle_by_value(tiles)
    retries = steps = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        inputs = whole(folder)
        with (
            LocalCluster(n_workers=4, threads_per_worker=1, dashboard_address=None, silence_logs=50) as cluster,
            Client(cluster) as client,
        ):
            client.register_plugin(tiles.Murder(SHARE, 0.06, seed))
            manager = threading.Thread(target=replace, args=(cluster,), daemon=True)
            manager.start()
            try:
                for run in range(runs):
                    report = slicewalk.cluster.convert(
                        inputs, folder / "out.slices", client, parts=9, fan_in=3, memory="64MiB", **tiles.OPTIONS
                    )
                    judge(folder)
                    retries += report["retries"]
                    steps += len(report["ran"])
                    print(f"run {run + 1}: {report['retries']} retries, {report['seconds']:.1f} s", flush=True)
            finally:
                ended.set()
                manager.join()
    print(f"{runs} runs, {steps} steps, {retries} of them began anew: all bytes equal, nothing left")
    assert retries >= runs // 2, "hardly anything died: the test tests nothing"


def start(folder: Path, *arguments: str) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-m", *arguments], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )


def end(processes: list[subprocess.Popen]) -> None:
    for process in processes:
        process.kill()
        process.wait()


def cluster_of(folder: Path, port: int, processes: list[subprocess.Popen]) -> None:
    """A scheduler and two workers, each in its own process."""
    address = f"tcp://127.0.0.1:{port}"
    processes.append(
        start(folder, "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard")
    )
    worker = ("distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard")
    processes.extend(start(folder, *worker) for _ in range(2))


def client_of(port: int) -> None:
    """Convert, as the client process of `scheduler`."""
    from distributed import Client

    with Client(f"tcp://127.0.0.1:{port}", timeout=60) as client:
        client.wait_for_workers(2, timeout=60)
        print("ready", flush=True)
        report = slicewalk.cluster.convert(
            sorted(Path().glob("*.las")), "out.slices", client, parts=9, fan_in=3, memory="64MiB", **tiles.OPTIONS
        )
    print(json.dumps({name: report[name] for name in ("parts", "retries", "skipped", "seconds")}), flush=True)


def await_parts(folder: Path, count: int) -> None:
    """Wait until `count` parts are done."""
    ends = time.monotonic() + 60
    while len(list(folder.glob(".out.slices.slicewalk-cluster/*-0-*.slices"))) < count and time.monotonic() < ends:
        time.sleep(0.005)


def scheduler(runs: int, seed: int = 1) -> None:
    """Kill the scheduler at a random moment of a conversion, and in every other run its client too."""
    import socket

    dice = random.Random(seed)
    resumed = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        whole(folder)
        for run in range(runs):
            with socket.socket() as free:
                free.bind(("127.0.0.1", 0))
                port = free.getsockname()[1]
            processes: list[subprocess.Popen] = []
            client = None
            try:
                both = run % 2 == 1
                for round_ in range(2):
                    if round_ == 0 or both:
                        client = subprocess.Popen(
                            [sys.executable, __file__, "client", str(port)],
                            cwd=folder,
                            stdout=subprocess.PIPE,
                            text=True,
                        )
                    cluster_of(folder, port, processes)
                    if client.stdout and (round_ == 0 or both):
                        assert client.stdout.readline() == "ready\n"
                    if round_ == 0:
                        await_parts(folder, dice.randrange(9))
                        if both:
                            end([client])
                        processes[0].send_signal(signal.SIGKILL)
                        end(processes)
                        processes.clear()
                report = json.loads(client.communicate(timeout=120)[0])
                assert client.returncode == 0
            finally:
                end([*processes, *([client] if client else [])])
            for path in folder.glob("dask-scratch-space"):
                import shutil

                shutil.rmtree(path)
            judge(folder)
            resumed += report["skipped"] > 0
            print(f"run {run + 1}: {'client and scheduler' if both else 'scheduler'}, {report}", flush=True)
    print(f"{runs} runs, {resumed} of them went on from finished steps: all bytes equal, nothing left")


if __name__ == "__main__":
    what, count = sys.argv[1], int(sys.argv[2])
    os.environ.setdefault("DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT", "60s")
    {"workers": workers, "scheduler": scheduler, "client": client_of}[what](count)
