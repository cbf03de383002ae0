"""LAZ as written by LASzip itself and by lazrs: random records give the same archive as LAZ and as LAS."""

import pathlib
import warnings

import numpy as np
import pytest

import slicewalk

laspy = pytest.importorskip("laspy")

WRITERS = {"LASzip": "Laszip", "lazrs": "Lazrs"}


def walk(random: np.random.Generator, count: int, dtype: np.dtype) -> np.ndarray:
    """Numbers that stay, change a little, by a stride, or arbitrarily."""
    bits = 8 * dtype.itemsize
    small = random.integers(-4, 5, count)
    stride = 40 * random.integers(0, 1000, count)
    # lazrs computes differences of times as if they could not overflow.
    anywhere = random.integers(0, 1 << min(bits, 61), count, dtype=np.int64) >> random.integers(0, 32, count)
    kind = random.choice(4, count, p=[0.5, 0.3, 0.15, 0.05])
    steps = np.choose(kind, [np.zeros(count, np.int64), small, stride, anywhere])
    with np.errstate(over="ignore"):
        return np.cumsum(steps, dtype=np.int64) & ((1 << min(bits, 61)) - 1)


def scan(random: np.random.Generator, point_format: int, count: int, extra: int) -> "laspy.LasData":
    """Random records: return numbers 0 to 15, scanner channels, times that jump."""
    header = laspy.LasHeader(point_format=point_format, version="1.3" if point_format < 6 else "1.4")
    header.scales, header.offsets = [0.01] * 3, [100.0] * 3
    for number in range(extra):
        header.add_extra_dim(laspy.ExtraBytesParams(name=f"extra {number}", type=np.uint8))
    points = laspy.ScaleAwarePointRecord.zeros(count, header=header)
    for name in points.array.dtype.names:
        field = points.array[name]
        if name in "XYZ":
            field[:] = np.cumsum(random.integers(-30, 31, count)) % 100_000 - 20_000
        else:
            field[:] = walk(random, count, field.dtype).astype(f"u{field.dtype.itemsize}").view(field.dtype)
    return laspy.LasData(header, points)


def archive(path: pathlib.Path, **options: object) -> bytes | str:
    """Bytes of the archive, or the reason if the random records leave nothing to convert or colour."""
    output = path.with_suffix(".slices")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", slicewalk.SlicewalkWarning)
        try:
            slicewalk.convert(path, output, pixel=1.0, force=True, units="m", **options)
        except slicewalk.ParameterError as error:
            return str(error)
    return output.read_bytes()


@pytest.mark.parametrize("writer", WRITERS)
@pytest.mark.parametrize("point_format", range(11))
def test_laz_of_each_writer_is_the_las(tmp_path: pathlib.Path, writer: str, point_format: int) -> None:
    pytest.importorskip("laszip" if writer == "LASzip" else "lazrs")
    random = np.random.default_rng(point_format)
    for count, extra in [(1, 0), (2, 1), (900, 3), (60_000, 1)]:
        las = scan(random, point_format, count, extra)
        las.write(tmp_path / "scan.las")
        las.write(tmp_path / "packed.laz", laz_backend=laspy.LazBackend[WRITERS[writer]])
        for options in [{}, {"exclude_class": [3]}, {"colour": "intensity"}]:
            plain, packed = (archive(tmp_path / name, **options) for name in ("scan.las", "packed.laz"))
            assert plain == packed, f"{count} points, {extra} extra bytes, {options}"
