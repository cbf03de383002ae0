"""Writes src/input/epsg_table.rs, the units of all EPSG systems, from the proj.db of an installed pyproj.

    pip install pyproj==3.8.0 && python tools/epsg_table.py > src/input/epsg_table.rs
"""

import os
import sqlite3

import pyproj


def main():
    db = sqlite3.connect(os.path.join(pyproj.datadir.get_data_dir(), "proj.db"))
    facts = dict(db.execute("select key, value from metadata"))
    lengths = dict(db.execute(
        "select code, conv_factor from unit_of_measure where auth_name = 'EPSG' and type = 'length'"
        " and name not like '% per %' and not deprecated order by code"))
    lengths[9003] = 1200 / 3937  # exact, like `US_SURVEY_FOOT_M`; the database is off by a rounding error

    def axes(system):
        return list(db.execute(
            "select orientation, uom_code from axis where coordinate_system_auth_name = 'EPSG'"
            " and coordinate_system_code = ? order by coordinate_system_order", (system,)))

    def height(axis):
        orientation, unit = axis
        return {"up": 1, "down": -1}[orientation] * lengths[unit]

    def rows(table, *columns):
        return db.execute(f"select code, {', '.join(columns)} from {table} where auth_name = 'EPSG'")

    systems = {}  # code -> (ground, up), as in the table
    for code, kind, system in rows("geodetic_crs", "type", "coordinate_system_code"):
        along = axes(system)
        ground = "Geocentric" if kind == "geocentric" else "Angles"
        up = height(along[2]) if ground == "Angles" and len(along) > 2 else None
        systems[code] = (ground, up)
    for code, system in rows("projected_crs", "coordinate_system_code"):
        along = axes(system)
        systems[code] = (f"Length({lengths[along[0][1]]!r})", height(along[2]) if len(along) > 2 else None)
    for code, system in rows("vertical_crs", "coordinate_system_code"):
        systems[code] = ("None", height(axes(system)[0]))
    parts = list(rows("compound_crs", "horiz_crs_code", "vertical_crs_code"))
    for code, ground, vertical in parts:
        systems[code] = (systems[ground][0], systems[vertical][1])
    compound = {code for code, _, _ in parts}

    codes = sorted(code for code in systems if code < 1 << 16)
    kinds = sorted({(*systems[code], code in compound) for code in codes}, key=repr)
    runs, last = [], None
    for code in codes:
        kind = 1 + kinds.index((*systems[code], code in compound))
        if last is not None and code > last + 1:
            runs.append((last + 1, 0))
        if not runs or runs[-1][1] != kind:
            runs.append((code, kind))
        last = code
    runs.append((last + 1, 0))

    print(f"""\
//! Units of the systems of EPSG data set {facts['EPSG.VERSION']} ({facts['EPSG.DATE']}), as pyproj {pyproj.__version__} (PROJ {facts['PROJ.VERSION']}) holds it.
//!
//! Written by `tools/epsg_table.py`: change that and run it again.

use super::epsg::Ground::{{Angles, Geocentric, Length, None as Nothing}};
use super::epsg::System;

/// Kinds of systems; runs name them by their place, from 1 on.
#[rustfmt::skip]
pub(super) const KINDS: [System; {len(kinds)}] = [""")
    for ground, up, several in kinds:
        ground = "Nothing" if ground == "None" else ground
        up = "None" if up is None else f"Some({up!r})"
        print(f"    System {{ ground: {ground}, up: {up}, is_compound: {str(several).lower()} }},")
    print("""\
];

/// Length units by their code (m).
#[rustfmt::skip]
pub(super) const UNITS: &[(u16, f64)] = &[""")
    wrapped(f"({code}, {factor!r})" for code, factor in sorted(lengths.items()))
    print("""\
];

/// First code of each run of one kind, in ascending order; 0: no system has these codes.
#[rustfmt::skip]
pub(super) const RUNS: &[(u16, u8)] = &[""")
    wrapped(f"({code},{kind})" for code, kind in runs)
    print("];")


def wrapped(items):
    line = "   "
    for item in items:
        if len(line) + len(item) + 2 > 120:
            print(line)
            line = "   "
        line += f" {item},"
    print(line)


main()
