"""Arrays of every kind that a caller may pass."""

from __future__ import annotations

import pathlib
import subprocess
import sys
import textwrap
import time
import tracemalloc

import numpy as np
import pytest

import scan
import slicewalk


@pytest.fixture
def boxes(rubble):
    low, high = rubble[1].bounds
    return scan.boxes(np.random.default_rng(2), low, high, 500)


def test_layouts_make_no_difference(rubble, boxes):
    archive = rubble[1]
    expected = archive.overlaps(boxes)
    wide = np.full((1000, 12), np.nan)
    wide[::2, ::2] = boxes
    packed = np.zeros(500, dtype=[("byte", "u1"), ("box", "f8", 6)])
    packed["box"] = boxes
    frozen = boxes.copy()
    frozen.flags.writeable = False
    same = [
        np.asfortranarray(boxes), wide[::2, ::2], boxes[::-1][::-1], packed["box"], frozen, boxes.astype(">f8"),
        boxes.tolist(),
    ]  # fmt: skip
    for given in same:
        assert (archive.overlaps(given) == expected).all()
    assert (archive.overlaps(boxes[::-1]) == expected[::-1]).all()
    assert (archive.overlaps(np.ma.masked_invalid(boxes)) == expected).all()
    single = boxes.astype(np.float32)
    assert (archive.overlaps(single) == archive.overlaps(single.astype(float))).all()
    assert archive.overlaps(np.array([[0, 0, 0, 1, 1, 1]])).shape == (1,)


def test_empty(rubble):
    archive = rubble[1]
    for ask, columns in ((archive.overlaps, 6), (archive.sweep, 9), (archive.cast, 7), (archive.floor, 6)):
        assert ask(np.empty((0, columns))).shape == (0,)
        assert ask([]).shape == (0,)


@pytest.mark.parametrize(
    ("given", "error", "says"),
    [
        (np.zeros((3, 5)), ValueError, r"boxes: expected shape \(N, 6\), found \(3, 5\)"),
        (np.zeros(6), ValueError, r"boxes.reshape\(1, 6\)"),
        (np.zeros((2, 2, 6)), ValueError, "found"),
        (np.zeros((2, 6), dtype=complex), TypeError, "complex128"),
        ([["a"] * 6], TypeError, "expected numbers"),
        (np.ma.masked_equal(np.arange(12.0).reshape(2, 6), 3), ValueError, r"masked ones; take .*boxes\[~boxes.mask"),
        (np.zeros((1, 6), dtype=object), TypeError, "object"),
        (None, TypeError, "object"),
        ("boxes", TypeError, "expected numbers"),
    ],
)
def test_wrong_arrays(rubble, given, error, says):
    with pytest.raises(error, match=says):
        rubble[1].overlaps(given)


def test_rows_that_make_no_sense(rubble, boxes):
    archive = rubble[1]
    boxes[321, 4] = np.nan
    with pytest.raises(slicewalk.ParameterError, match="row 321") as raised:
        archive.overlaps(boxes)
    assert raised.value.row == 321
    boxes[7, 0] = 99
    with pytest.raises(ValueError, match="row 7:"):
        archive.floor(boxes)
    many = np.zeros((300_000, 6))
    many[200_001] = np.nan
    with pytest.raises(ValueError, match="row 200001:"):
        archive.overlaps(many)
    for rays in ([0, 0, 0, 0, 0, 0, 1], [0, 0, 0, 1, 0, 0, -1], [0, 0, np.nan, 1, 0, 0, 1]):
        with pytest.raises(ValueError, match="row 0"):
            archive.cast([rays])
    with pytest.raises(ValueError, match="finite"):
        archive.sweep([[0, 0, 0, 1, 1, 1, np.inf, 0, 0]])
    with pytest.raises(ValueError, match="row 0"):
        archive.overlaps_spheres([[0, 0, 0, -1]])


def test_infinite_ends(rubble):
    archive = rubble[1]
    inf = np.inf
    assert archive.overlaps([[-inf, -inf, -inf, inf, inf, inf]]) == slicewalk.HIT
    highest = archive.floor([[0, 0, 0, 1, 1, 100]])
    assert archive.floor([[0, 0, -inf, 1, 1, inf]]) == highest
    assert archive.floor([[0, 0, 0.001, 1, 1, inf]]) == highest
    assert np.isneginf(archive.floor([[0, 0, 50, 1, 1, inf]]))
    lowest = archive.ceiling([[0, 0, -100, 1, 1, 100]])
    assert archive.ceiling([[0, 0, -inf, 1, 1, inf]]) == lowest
    assert np.isposinf(archive.ceiling([[0, 0, -inf, 1, 1, -50]]))


def test_threads_change_nothing(rubble):
    archive = rubble[1]
    low, high = archive.bounds
    boxes = scan.boxes(np.random.default_rng(5), low, high, 150_001)
    one = archive.overlaps(boxes, threads=1)
    for threads in (2, 3, 16, None):
        assert (archive.overlaps(boxes, threads=threads) == one).all()
    for threads in (0, -1):
        with pytest.raises((ValueError, OverflowError)):
            archive.overlaps(boxes, threads=threads)


def address(array):
    return array.__array_interface__["data"][0]


def test_pages_are_views_of_one_memory(rubble):
    archive = rubble[1]
    page = archive.page(tuple(archive.keys()[0]))
    column = archive.column(*rubble[0][0, :2])
    for owner, names in (
        (page, ["occupancy", "starts", "bottoms", "tops", "obstacle"]),
        (column, ["bottoms", "tops", "obstacle"]),
    ):
        for name in names:
            first, second = getattr(owner, name), getattr(owner, name)
            assert first.size
            assert address(first) == address(second)
            assert first.base is owner
            with pytest.raises(ValueError, match="read-only"):
                first[...] = 0
            with pytest.raises(ValueError, match="WRITEABLE"):
                first.flags.writeable = True
    tops = page.tops
    copy = tops.copy()
    del page, archive
    assert (tops == copy).all(), "an array keeps its page"


def test_input_is_not_copied_whole_and_answers_are_handed_over(rubble):
    archive = rubble[1]
    archive.load()
    boxes = np.zeros((500_000, 6))
    tracemalloc.start()
    answers = archive.overlaps(boxes)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # numpy reports each array that it allocates to tracemalloc: a copy would be 24 MB, the answers 0.5 MB.
    assert peak < 400_000
    assert not answers.flags.owndata
    assert answers.flags.writeable


def test_boxes_may_come_as_corners(rubble, boxes):
    archive = rubble[1]
    corners = boxes.reshape(-1, 2, 3)
    assert (archive.overlaps(corners) == archive.overlaps(boxes)).all()
    assert (archive.floor(corners.tolist()) == archive.floor(boxes)).all()
    with pytest.raises(ValueError, match="expected shape"):
        archive.sweep(np.zeros((3, 2, 3)))
    assert (archive.region(archive.bounds).kind == archive.region(archive.bounds.ravel()).kind).all()
    assert archive.region(archive.bounds.tolist()).occupied.sum() == archive.voxels
    region = archive.region(iter([0, 0, 0, 1, 1, 1]))
    assert region.kind.shape == archive.region([[0, 0, 0], [1, 1, 1]]).kind.shape
    short = [[0, 0, 0, 1, 1], [[0, 0], [1, 1]], [0, 1, [1, 2, 3, 4]], [[0, 0, 0], [1, 1, np.nan]], np.zeros((3, 2))]
    wrong = [*short, range(1 << 62), None, "box", np.zeros(1 << 20), 5]
    for bounds in wrong:
        with pytest.raises(ValueError, match="bounds: expected 6 finite numbers") as raised:
            archive.region(bounds)
        assert len(str(raised.value)) < 400


def test_a_row_asks_nothing_of_the_system(rubble):
    archive, box = rubble[1], np.zeros((1, 6))
    archive.load()

    def least(**options):
        def once():
            start = time.perf_counter()
            for _ in range(100):
                archive.overlaps(box, **options)
            return time.perf_counter() - start

        return min(once() for _ in range(20))

    assert least() < 2 * least(threads=1)


def limited(script, folder):
    """Run a script in a process with 2 GiB of address space beyond that of its imports."""
    head = """
        import pathlib, re, resource, numpy as np, slicewalk
        def size():
            return int(re.search(r"VmSize:\\s+(\\d+)", pathlib.Path("/proc/self/status").read_text())[1]) << 10
        before = size()
        archive = slicewalk.open("rubble.slices")
        stream = slicewalk.Stream(archive, "16MiB")
        archive.load()
        low, high = archive.bounds
        resource.setrlimit(resource.RLIMIT_AS, (before + (2 << 30),) * 2)
    """
    code = textwrap.dedent(head) + textwrap.dedent(script)
    return subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, timeout=300)


@pytest.mark.skipif(not pathlib.Path("/proc/self/status").exists(), reason="needs /proc")
@pytest.mark.parametrize(
    "work",
    [
        "archive.overlaps(np.broadcast_to([0.0, 0, 0, 1, 1, 1], (1 << 42, 6)))",
        "archive.floor(np.broadcast_to([0.0, 0, 0, 1, 1, 1], (1 << 29, 6)))",
        "archive.sweep(np.broadcast_to(0.0, (1 << 42, 9)))",
        "archive.cast(np.broadcast_to(1.0, (1 << 42, 7)))",
        "archive.overlaps_spheres(np.broadcast_to(1.0, (1 << 42, 4)))",
        "archive.overlaps_cylinders(np.broadcast_to(1.0, (1 << 42, 5)))",
        "stream.view().ceiling(np.broadcast_to([0.0, 0, 0, 1, 1, 1], (1 << 42, 6)))",
        "archive.region([0, 0, 0, 100, 100, 300])",
        "slicewalk.Walker((0, 0, 0)).path(archive, np.broadcast_to(1.0, (1 << 42, 2)))",
        "slicewalk.Walker((0, 0, 0)).path(archive, np.broadcast_to(1.0, (1 << 42, 3)))",
    ],
)
def test_memory_that_cannot_be_had_is_an_error(folder, rubble, work):
    script = f"""
        try:
            {work}
        except MemoryError as error:
            print("MemoryError", error)
        assert archive.overlaps([[*low, *high]]) == slicewalk.HIT
    """
    done = limited(script, folder)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("MemoryError"), done.stdout + done.stderr


@pytest.mark.skipif(not pathlib.Path("/proc/self/status").exists(), reason="needs /proc")
def test_a_path_without_memory_for_its_frames_is_an_error(folder, rubble):
    # From that height the pawn falls for hours. Smaller limits end the path sooner.
    script = """
        walker = slicewalk.Walker((1000, 1000, 1e6))
        resource.setrlimit(resource.RLIMIT_AS, (size() + (128 << 20),) * 2)
        try:
            walker.path(archive, [(0, 0)], hz=1e5, max_seconds=1e6)
        except MemoryError as error:
            print("MemoryError", error)
        assert walker.state == "falling"
    """
    done = limited(script, folder)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("MemoryError no memory for a path of over "), done.stdout + done.stderr


@pytest.mark.skipif(not pathlib.Path("/proc/self/status").exists(), reason="needs /proc")
def test_boxes_of_a_stream_are_read_block_by_block(folder, rubble):
    # 48 GiB of rows; a timer callback interrupts the loading.
    script = """
        import signal
        def enough(*_):
            raise KeyError("enough")
        signal.signal(signal.SIGALRM, enough)
        signal.setitimer(signal.ITIMER_REAL, 1)
        try:
            stream.load(np.broadcast_to([0.0, 0, 0, 1, 1, 1], (1 << 30, 6)))
        except KeyError as error:
            print(error)
    """
    done = limited(script, folder)
    assert done.stdout == "'enough'\n", done.stderr
    with slicewalk.Stream(rubble[1], "16MiB") as stream:
        boxes = np.zeros((70_000, 6))
        boxes[69_999, 3] = -1
        with pytest.raises(slicewalk.ParameterError, match="boxes: row 69999: ") as raised:
            stream.load(boxes)
        assert raised.value.row == 69_999


@pytest.mark.skipif(not pathlib.Path("/proc/self/status").exists(), reason="needs /proc")
def test_empty_space_of_a_region_takes_no_memory(folder, rubble):
    # Three arrays of 600 MB, of which the scan touches only little.
    script = """
        region = archive.region([*low, *(high + (40, 40, 500))])
        assert region.kind.size > 2e8
        # Its own peak: `ru_maxrss` would count that of the process of the tests, before the script began.
        print(int(re.search(r"VmHWM:\\s+(\\d+)", pathlib.Path("/proc/self/status").read_text())[1]) >> 10)
        print(region.kind.flags.owndata)
    """
    done = limited(script, folder)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout.split()[0]) < 300
    assert done.stdout.split()[1] == "True"
