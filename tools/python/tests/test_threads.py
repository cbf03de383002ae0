"""Many threads, interpreters, and signals."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import scan
import slicewalk


def test_many_threads_ask_one_archive(folder, rubble):
    boxes = scan.boxes(np.random.default_rng(6), *rubble[1].bounds, 2000)
    rays = np.hstack([boxes[:, :3], np.random.default_rng(7).normal(0, 1, (2000, 3)), np.full((2000, 1), 9.0)])
    expected = rubble[1].overlaps(boxes), rubble[1].cast(rays), rubble[1].floor(boxes)
    archive = slicewalk.open(folder / "rubble.slices")
    start = threading.Barrier(8)

    def ask(_):
        start.wait()
        for _ in range(20):
            answers = archive.overlaps(boxes), archive.cast(rays), archive.floor(boxes)
            assert all((a == b).all() for a, b in zip(answers, expected, strict=True))
        return archive.page(tuple(archive.keys()[0])).tops.sum()

    with ThreadPoolExecutor(8) as pool:
        assert len(set(pool.map(ask, range(8)))) == 1


def test_threads_share_a_stream(folder, rubble):
    archive = slicewalk.open(folder / "rubble.slices")
    boxes = scan.boxes(np.random.default_rng(6), *archive.bounds, 300)
    expected = archive.overlaps(boxes)
    with slicewalk.Stream(archive, "32MiB") as stream:

        def ask(number):
            for row in range(number, 300, 4):
                assert stream.load(boxes[row : row + 1])["left_out"] == 0
                assert stream.view().overlaps(boxes[row : row + 1]) == expected[row]
                answers = stream.view().overlaps(boxes)
                known = answers != slicewalk.NOT_LOADED
                assert (answers[known] == expected[known]).all()

        with ThreadPoolExecutor(4) as pool:
            list(pool.map(ask, range(4)))


def test_other_threads_run_during_a_batch(rubble):
    archive = rubble[1]
    boxes = np.tile(scan.boxes(np.random.default_rng(6), *archive.bounds, 1000), (2000, 1))
    interval = sys.getswitchinterval()
    # No thread is ever asked to release the interpreter, so this one runs only while a batch releases it.
    sys.setswitchinterval(3600)
    try:
        for _ in range(20):
            thread = threading.Thread(target=archive.overlaps, args=(boxes,))
            count = 0
            thread.start()
            while thread.is_alive():
                time.sleep(0)
                count += 1
            if count > 10:
                break
    finally:
        sys.setswitchinterval(interval)
        thread.join()
    assert count > 10, "a batch keeps the interpreter"


def test_an_array_that_changes_meanwhile_is_no_danger(rubble):
    archive = rubble[1]
    boxes = np.tile(scan.boxes(np.random.default_rng(6), *archive.bounds, 1000), (300, 1))
    other = boxes[::-1].copy()
    kept = boxes.copy()
    allowed = archive.overlaps(kept), archive.overlaps(other)
    stop = threading.Event()

    def write():
        while not stop.is_set():
            boxes[:] = other
            boxes[:] = kept

    thread = threading.Thread(target=write)
    thread.start()
    try:
        for _ in range(10):
            answers = archive.overlaps(boxes)
            # A half-written row may be a different box; it is answered too.
            same = (answers == allowed[0]) | (answers == allowed[1])
            assert same.mean() > 0.99
    except slicewalk.ParameterError:
        pass  # or the row was not a valid box for a moment
    finally:
        stop.set()
        thread.join()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
@pytest.mark.filterwarnings("ignore")
def test_a_stream_can_be_closed_after_a_fork(rubble):
    with slicewalk.Stream(rubble[1], "64MiB") as stream:
        process = os.fork()
        if process == 0:
            told = 1
            try:
                stream.close()
                told = 0
            finally:
                os._exit(told)
        assert os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) == 0


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="needs a timer")
def test_a_region_hears_signals(tmp_path):
    axes = [np.arange(100) * 0.1 + 0.05] * 3
    with slicewalk.Writer(tmp_path / "solid.slices", pixel=0.1, slice=0.1) as writer:
        writer.write(np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3))
    archive = slicewalk.open(tmp_path / "solid.slices")
    archive.load()
    start = time.perf_counter()
    assert archive.region(archive.bounds).occupied.all()
    whole = time.perf_counter() - start
    if whole < 0.2:
        pytest.skip("too fast to be stopped")

    def stop(*_):
        raise KeyError

    def ask():
        signal.setitimer(signal.ITIMER_REAL, 0.01)
        archive.region(archive.bounds)

    before = signal.signal(signal.SIGALRM, stop)
    try:
        start = time.perf_counter()
        with pytest.raises(KeyError):
            ask()
        assert time.perf_counter() - start < 0.75 * whole
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("first", ["", "import slicewalk"])
def test_a_subinterpreter_is_refused(first):
    script = f"""
        try:
            import _interpreters as interpreters
        except ImportError:
            import _xxsubinterpreters as interpreters
        {first}
        code = '''
        try:
            import slicewalk
        except ImportError as error:
            assert "subinterpreter" in str(error), error
        else:
            raise AssertionError("it was imported")
        '''
        import textwrap
        failed = interpreters.run_string(interpreters.create(), textwrap.dedent(code))
        assert failed is None, failed
        import slicewalk
        print("refused")
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], check=False, capture_output=True, text=True)
    assert done.stdout == "refused\n", done.stderr
