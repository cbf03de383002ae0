//! Random houses of square rooms, whose truth is known room by room.

use scangen::{WriteSpec, write_las};
use slicewalk::NoMonitor;
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use std::process::{Command, Output};
use tempfile::TempDir;

/// Edge of a room, width of a door, height of walls and doors (m), spacing of points.
pub const ROOM_M: f64 = 3.0;
const DOOR_M: f64 = 1.0;
const HIGH_M: f64 = 2.2;
const SPACING_M: f64 = 0.05;

/// Random numbers (splitmix64).
pub struct Random(pub u64);

impl Random {
    pub fn below(&mut self, most: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mixed = (self.0 ^ self.0 >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((mixed ^ mixed >> 31) >> 11) as usize % most
    }
}

/// A wall between two rooms.
#[derive(Clone, Copy)]
pub struct Side {
    pub rooms: [usize; 2],
    /// Middle of the wall (m), and the axis along which it stands.
    middle: [f64; 2],
    along: usize,
    pub has_door: bool,
    pub is_open: bool,
}

/// A house of rooms in rows.
pub struct House {
    rooms: usize,
    pub sides: Vec<Side>,
    pub random: Random,
}

impl House {
    /// Makes a house in which a third of the walls has no door, and a third of the doors is shut.
    pub fn new(rooms: usize, seed: u64) -> Self {
        let mut random = Random(seed);
        let mut sides = Vec::new();
        for room in 0..rooms * rooms {
            let [i, j] = [room % rooms, room / rooms];
            let mut side = |other: usize, middle: [f64; 2], along: usize| {
                let has_door = random.below(3) > 0;
                let is_open = has_door && random.below(3) > 0;
                sides.push(Side { rooms: [room, other], middle, along, has_door, is_open });
            };
            let [x, y] = [i, j].map(|at| at as f64 * ROOM_M);
            if i + 1 < rooms {
                side(room + 1, [x + ROOM_M, y + ROOM_M / 2.0], 1);
            }
            if j + 1 < rooms {
                side(room + rooms, [x + ROOM_M / 2.0, y + ROOM_M], 0);
            }
        }
        Self { rooms, sides, random }
    }

    /// Returns the middle of a room (m).
    pub fn middle(&self, room: usize) -> [f64; 2] {
        [room % self.rooms, room / self.rooms].map(|at| (at as f64 + 0.5) * ROOM_M)
    }

    /// Returns a box around the door of a side.
    pub fn door(&self, side: usize) -> [f64; 6] {
        self.around(side, DOOR_M / 2.0, 0.02)
    }

    /// Returns a box around the wall of a side, without the walls that it meets.
    pub fn wall(&self, side: usize) -> [f64; 6] {
        self.around(side, ROOM_M / 2.0 - 0.3, 0.02)
    }

    fn around(&self, side: usize, half: f64, bottom: f64) -> [f64; 6] {
        let Side { middle, along, .. } = self.sides[side];
        let reach = [0, 1].map(|axis| if axis == along { half } else { 0.12 });
        [middle[0] - reach[0], middle[1] - reach[1], bottom, middle[0] + reach[0], middle[1] + reach[1], HIGH_M]
    }

    /// Returns the points of the floor and of all walls and shut doors.
    pub fn points(&self) -> Vec<[f64; 3]> {
        let length = self.rooms as f64 * ROOM_M;
        let count = |length: f64| (length / SPACING_M).round() as i32;
        let at = |n: i32| f64::from(n) * SPACING_M + SPACING_M / 2.0;
        let floor = (0..count(length)).flat_map(|i| (0..count(length)).map(move |j| [at(i), at(j), 0.0]));
        let mut points: Vec<[f64; 3]> = floor.collect();
        let mut wall = |from: [f64; 2], along: usize, length: f64, gap: Option<f64>| {
            for (i, k) in (0..count(length)).flat_map(|i| (0..count(HIGH_M)).map(move |k| (i, k))) {
                let mut place = [from[0] + 0.025, from[1] + 0.025, at(k)];
                place[along] = from[along] + at(i);
                if gap.is_none_or(|half| (at(i) - length / 2.0).abs() > half) {
                    points.push(place);
                }
            }
        };
        for from in [[0.0, 0.0], [0.0, length - SPACING_M]] {
            wall(from, 0, length, None);
            wall([from[1], 0.0], 1, length, None);
        }
        for side in &self.sides {
            let mut from = side.middle;
            from[side.along] -= ROOM_M / 2.0;
            wall(from, side.along, ROOM_M, side.is_open.then_some(DOOR_M / 2.0));
        }
        points
    }
}

/// Writes the points as a scan and converts it at pixels of 0.1 m.
pub fn archive_of(points: Vec<[f64; 3]>) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let scan = folder.path().join("scan.las");
    write_las(&scan, points, &WriteSpec::for_path(&scan)).unwrap();
    let mut options = ConvertOptions::new(vec![scan], folder.path().join("a.slices"));
    options.grid.pixel = PixelSize::Metres(0.1);
    convert(&options, &NoMonitor).unwrap();
    folder
}

/// Runs a command of the program.
pub fn slicetool(folder: &TempDir, command: &str, arguments: &[&str]) -> Output {
    let mut slicetool = Command::new(env!("CARGO_BIN_EXE_slicetool"));
    slicetool.current_dir(folder.path()).arg(command).args(arguments).output().unwrap()
}
