"""Asks the library through ctypes what a table of expected answers says, bit by bit: LIBRARY ARCHIVE TABLE."""

import ctypes
import sys
from ctypes import POINTER, byref, c_char_p, c_double, c_size_t, c_uint8, c_void_p

library = ctypes.CDLL(sys.argv[1])
library.sw_last_error.restype = c_char_p


def check(status: int) -> None:
    if status != 0:
        sys.exit(library.sw_last_error().decode())


def ask(call: str, rows: list[list[float]], answer: type) -> list[float]:
    numbers = [number for row in rows for number in row]
    answers = (answer * len(rows))()
    function = getattr(library, call)
    function.argtypes = [c_void_p, POINTER(c_double), c_size_t, POINTER(answer), c_size_t]
    check(function(pages, (c_double * len(numbers))(*numbers), len(numbers), answers, len(rows)))
    return list(answers)


archive, pages = c_void_p(), c_void_p()
check(library.sw_open_file(sys.argv[2].encode(), byref(archive)))
check(library.sw_pages_load(archive, byref(pages)))
table = [[float(word) for word in line.split()] for line in open(sys.argv[3])]
boxes = [[*row[:3], *(v + row[6] for v in row[:3])] for row in table]
found = zip(
    ask("sw_overlaps_boxes", boxes, c_uint8),
    ask("sw_overlaps_spheres", [[*row[:3], row[6]] for row in table], c_uint8),
    ask("sw_overlaps_cylinders", [[*row[:3], row[6], 1.0] for row in table], c_uint8),
    ask("sw_cast_rays", [[*row[:6], 20.0] for row in table], c_double),
    ask("sw_sweep_boxes", [[*box, *row[3:6]] for box, row in zip(boxes, table)], c_double),
    ask("sw_floors", boxes, c_double),
    [numbers[0] for numbers in ask("sw_nearest_surfaces", [[*row[:3], 1.0] for row in table], c_double * 7)],
)
for number, (row, answers) in enumerate(zip(table, found)):
    if row[7:] != list(answers):
        sys.exit(f"row {number}: expected {row[7:]}, found {answers}")
check(library.sw_pages_close(pages))
check(library.sw_archive_close(archive))
print(len(table), "rows are the same")
