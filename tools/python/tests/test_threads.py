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


def interrupted(work, handler):
    """Do some work, which a signal handler interrupts soon."""
    before = signal.signal(signal.SIGALRM, handler)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.01)
        work()
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def check_that_signals_end(work):
    """Check that an exception of a signal handler ends some work before its own end."""

    def stop(*_):
        raise KeyError

    start = time.perf_counter()
    work()
    whole = time.perf_counter() - start
    if whole < 0.2:
        pytest.skip("too fast to be stopped")
    start = time.perf_counter()
    with pytest.raises(KeyError):
        interrupted(work, stop)
    assert time.perf_counter() - start < 0.75 * whole


HAS_TIMER = pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="needs a timer")


@HAS_TIMER
def test_a_region_hears_signals(tmp_path):
    axes = [np.arange(100) * 0.1 + 0.05] * 3
    with slicewalk.Writer(tmp_path / "solid.slices", pixel=0.1, slice=0.1) as writer:
        writer.write(np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3))
    archive = slicewalk.open(tmp_path / "solid.slices")
    archive.load()
    assert archive.region(archive.bounds).occupied.all()
    check_that_signals_end(lambda: archive.region(archive.bounds))


@HAS_TIMER
@pytest.mark.parametrize("threads", [1, 2])
def test_a_batch_hears_signals(tmp_path, threads):
    # A solid cube of 10 m: one voxel in each pixel, with a point at either end.
    x, y, z = np.meshgrid(np.arange(100) * 0.1 + 0.05, np.arange(100) * 0.1 + 0.05, [0.01, 9.99])
    points = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    archive = slicewalk.from_numpy(points, tmp_path / "cube.slices", pixel=0.1, slice=10)
    # In its middle, thousands of pixels are as near as the surface.
    assert archive.nearest_surfaces([[5, 5, 5]], 6.0).distance[0] == pytest.approx(-5, abs=0.1)
    places = np.full((5000, 3), 5.0)
    if threads == 2:
        # The calling thread answers the first half, which is far from everything, and waits for the other thread.
        half = 1 << 13
        places = np.vstack([np.full((half, 3), 1000.0), places, np.full((half - len(places), 3), 1000.0)])
    check_that_signals_end(lambda: archive.nearest_surfaces(places, 6.0, threads=threads))


@HAS_TIMER
def test_a_walker_on_a_path_refuses_all_other_uses(folder):
    room, walker = slicewalk.open(folder / "room.slices"), slicewalk.Walker((1, 1, 0.1))
    room.load()
    refused = []

    def interrupt(*_):
        if repr(walker) != "<slicewalk.Walker on a path>":
            # The path has not begun.
            signal.setitimer(signal.ITIMER_REAL, 0.01)
            return
        for use in (
            lambda: walker.feet,
            lambda: walker.state,
            lambda: walker.falling,
            lambda: walker.place((1, 1, 0.1)),
            lambda: walker.step(room, 0.1),
            lambda: walker.path(room, [(1, 1)]),
        ):
            with pytest.raises(RuntimeError, match=r"^walker: its path has not ended yet; ") as raised:
                use()
            refused.append(raised.value)
        raise KeyError

    # Keeps turning.
    waypoints = np.tile([(1.0, 1.0), (7.0, 5.0)], (100_000, 1))
    with pytest.raises(KeyError):
        interrupted(lambda: walker.path(room, waypoints, hz=1000, max_seconds=1e6), interrupt)
    assert len(refused) == 6
    assert walker.path(room, [walker.feet[:2]]).state == "arrived"


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
