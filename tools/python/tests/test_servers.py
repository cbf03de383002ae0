"""Archives on servers that are slow, silent, or fail sometimes."""

from __future__ import annotations

import contextlib
import pickle
import random
import signal
import socket
import subprocess
import sys
import textwrap
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest

import scan
import slicewalk
import store as stores


@pytest.fixture(scope="module")
def city(tmp_path_factory):
    """An archive of hundreds of pages."""
    path = tmp_path_factory.mktemp("city") / "city.slices"
    with slicewalk.Writer(path, pixel=0.02) as writer:
        writer.write(scan.millimetres(np.random.default_rng(8).uniform((0, 0, 0), (32, 32, 0.2), (60_000, 3))))
    return path.read_bytes()


@contextlib.contextmanager
def serving(data, manner):
    """Serve `data`; `manner` is how a request is answered: good, silent, a status, cut or reset."""
    asked = []

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self):
            asked.append(self.headers["Range"])
            how = manner(len(asked))
            if how == "silent":
                released.wait(60)
                self.close_connection = True
                return
            if how == "reset":
                self.close_connection = True
                return
            if how == 503:
                self.send_response(503)
                self.send_header("Content-Length", "0")
                self.end_headers()
                return
            first, last = map(int, self.headers["Range"].removeprefix("bytes=").split("-"))
            body = data[first : last + 1]
            self.send_response(206)
            self.send_header("Content-Range", f"bytes {first}-{first + len(body) - 1}/{len(data)}")
            self.send_header("Content-Length", str(len(body)))
            self.send_header("ETag", '"1"')
            self.end_headers()
            if how == "cut":
                body = body[: len(body) // 2]
                self.close_connection = True
            self.wfile.write(body)

        def log_message(self, *arguments):
            """Log nothing."""

    released = threading.Event()
    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads, server.block_on_close = True, False
    thread = threading.Thread(target=server.serve_forever, args=(0.05,))
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/city.slices", asked
    finally:
        released.set()
        server.shutdown()
        thread.join()
        server.server_close()


def test_all_pages_come_in_a_few_requests(city):
    with serving(city, lambda _: "good") as (url, asked):
        archive = slicewalk.open(url)
        assert len(asked) == 2
        archive.load()
        assert len(archive.keys()) > 500
        assert len(asked) <= 4 + -(-len(city) // (1 << 20))
        box = [[0, 0, 0, 32, 32, 1]]
        assert archive.floor(box) == slicewalk.open(city).floor(box)


def test_a_silent_server_is_left_after_the_timeout(city):
    quiet = [False]
    with serving(city, lambda _: "silent" if quiet[0] else "good") as (url, asked):
        archive = slicewalk.open(url, timeout=1)
        quiet[0] = True
        for wait in (lambda: slicewalk.open(url, timeout=1), archive.load, archive.info):
            count, start = len(asked), time.monotonic()
            with pytest.raises(slicewalk.FileError, match="no answer within 1 s"):
                wait()
            assert 0.9 < time.monotonic() - start < 3
            assert len(asked) == count + 1
    for timeout in (0, -1, np.nan):
        with pytest.raises(slicewalk.ParameterError, match="timeout: expected seconds above 0"):
            slicewalk.open(url, timeout=timeout)


def test_opening_takes_no_longer_than_the_timeout_whatever_the_server_does(city):
    with serving(city, lambda _: 503) as (url, _):
        start = time.monotonic()
        with pytest.raises(slicewalk.FileError):
            slicewalk.open(url, timeout=1, retries=1000)
        assert time.monotonic() - start < 3
    # Nothing accepts the connection.
    with socket.create_server(("127.0.0.1", 0), backlog=0) as server:
        start = time.monotonic()
        with pytest.raises(slicewalk.FileError):
            slicewalk.open(f"http://127.0.0.1:{server.getsockname()[1]}/a.slices", timeout=1)
        assert time.monotonic() - start < 3


@pytest.mark.parametrize(
    "work",
    [
        "slicewalk.open(url, timeout=60)",
        "archive.load()",
        "archive.crs",
        "stream.load(box)",
        "slicewalk.convert(url.replace('.slices', '.las'), 'none.slices')",
        "slicewalk.convert(url, 'none.slices', plan=url)",
        "slicewalk.convert('s3://bucket/*.laz', 'none.slices')",
        "slicewalk.Writer('s3://bucket/none.slices', pixel=0.1)",
    ],
)
def test_ctrl_c_is_heard_while_a_server_is_waited_for(city, work):
    quiet, script = (
        threading.Event(),
        f"""
        import os, signal, sys, slicewalk
        signal.signal(signal.SIGINT, signal.default_int_handler)
        url, box = sys.argv[1], [[0, 0, 0, 32, 32, 1]]
        os.environ.update(AWS_ENDPOINT=url.rpartition("/")[0], AWS_ALLOW_HTTP="true")
        archive = slicewalk.open(url, timeout=60)
        stream = slicewalk.Stream(archive, "16MiB")
        print("open", flush=True)
        sys.stdin.readline()
        try:
            {work}
        except KeyboardInterrupt:
            stream.close()
            sys.exit(77)
    """,
    )
    with (
        serving(city, lambda _: "silent" if quiet.is_set() else "good") as (url, asked),
        subprocess.Popen(
            [sys.executable, "-c", textwrap.dedent(script), url],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        ) as process,
    ):
        assert process.stdout.readline() == "open\n"
        quiet.set()
        count = len(asked)
        process.stdin.write("\n")
        process.stdin.flush()
        while len(asked) == count:
            time.sleep(0.01)
        start = time.monotonic()
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=60) == 77
        assert time.monotonic() - start < 5


@pytest.mark.parametrize("fault", [503, "reset", "cut"])
def test_archives_survive_what_conversions_survive(city, fault):
    dice = random.Random(3)
    with serving(city, lambda _: fault if dice.random() < 0.3 else "good") as (url, asked):
        for _ in range(3):
            archive = slicewalk.open(url, timeout=60)
            assert archive.load() == slicewalk.open(city).load()
        assert len(asked) > 12
    with serving(city, lambda number: fault if number > 2 else "good") as (url, asked):
        archive = slicewalk.open(url, retries=2, timeout=60)
        with pytest.raises(slicewalk.FileError):
            archive.load()
        assert len(asked) == 2 + 3


def test_a_pickle_keeps_how_a_server_is_asked(folder, monkeypatch):
    with stores.serving() as store:
        store.put("/bucket/room.slices", (folder / "room.slices").read_bytes())
        settings = {name.lower(): value for name, value in store.environment().items()}
        archive = slicewalk.open("s3://bucket/room.slices", settings=settings, timeout=33, retries=2)
        pickled = pickle.dumps(archive)
        asked = len(store.requests)
        assert pickle.loads(pickled).voxels == archive.voxels
        assert len(store.requests) > asked
    options = archive.__reduce__()[1][2]
    assert options == {"timeout": 33, "retries": 2, "settings": settings}
    assert slicewalk.open(folder / "room.slices").__reduce__()[1][2] == {}
    # The other store, in the environment, receives no request.
    with stores.serving() as store:
        for name, value in store.environment().items():
            monkeypatch.setenv(name, value)
        store.put("/bucket/room.slices", (folder / "room.slices").read_bytes())
        with pytest.raises(slicewalk.FileError):
            pickle.loads(pickled)
