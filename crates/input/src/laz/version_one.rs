//! The earliest items of LASzip (version 1: `POINT10`, `GPSTIME11`, `RGB12`, `BYTE`), with simpler coding than later
//! versions.

use super::coder::{Coder, Model, Numbers};
use super::fields::{COLOUR_BYTES, Lazily};
use super::sequence::{ANGLE, CLASS, FLAGS, INTENSITY, Item, POINT_BYTES, SOURCE_ID, USER};

/// A point: x and y as steps like the last three, z like the last; then which other fields change, and their values.
pub(super) struct Point {
    last: [u8; POINT_BYTES],
    /// The last three steps in x and y; `oldest`: index of the oldest one.
    steps: [[i32; 3]; 2],
    oldest: usize,
    x: Numbers,
    y: Numbers,
    z: Numbers,
    changes: Model<64>,
    intensity: Numbers,
    flags: Lazily,
    class: Lazily,
    angle: Numbers,
    user: Lazily,
    source_id: Numbers,
}

impl Point {
    fn short(&self, at: usize) -> i32 {
        u16::from_le_bytes([self.last[at], self.last[at + 1]]).into()
    }

    /// Returns the median of the last three steps along an axis.
    fn step(&self, axis: usize) -> i32 {
        let [a, b, c] = self.steps[axis];
        a.min(b).max(a.max(b).min(c))
    }

    fn coordinate(&self, axis: usize) -> i32 {
        self.last[4 * axis..].first_chunk().map_or(0, |&four| i32::from_le_bytes(four))
    }

    fn set(&mut self, axis: usize, number: i32) {
        self.last[4 * axis..4 * axis + 4].copy_from_slice(&number.to_le_bytes());
    }
}

impl Item for Point {
    fn new(first: &[u8]) -> Self {
        Self {
            last: first.first_chunk().copied().unwrap_or_default(),
            steps: [[0; 3]; 2],
            oldest: 0,
            x: Numbers::new(32, 1),
            y: Numbers::new(32, 20),
            z: Numbers::new(32, 20),
            changes: Model::new(64),
            intensity: Numbers::new(16, 1),
            flags: Lazily::new(256, 256),
            class: Lazily::new(256, 256),
            angle: Numbers::new(8, 2),
            user: Lazily::new(256, 256),
            source_id: Numbers::new(16, 1),
        }
    }

    fn next(&mut self, coder: &mut Coder, field: &mut [u8]) -> bool {
        let step_x = self.x.next(coder, 0, self.step(0));
        let step_y = self.y.next(coder, self.x.size().min(19) as usize, self.step(1));
        self.steps[0][self.oldest] = step_x;
        self.steps[1][self.oldest] = step_y;
        self.oldest = (self.oldest + 1) % 3;
        let size = (self.x.size() + self.y.size()) / 2;
        let z = self.z.next(coder, size.min(19) as usize, self.coordinate(2));
        self.set(0, self.coordinate(0).wrapping_add(step_x));
        self.set(1, self.coordinate(1).wrapping_add(step_y));
        self.set(2, z);
        let changes = coder.symbol(&mut self.changes);
        if changes & 32 != 0 {
            let intensity = self.intensity.next(coder, 0, self.short(INTENSITY)) as u16;
            self.last[INTENSITY..FLAGS].copy_from_slice(&intensity.to_le_bytes());
        }
        if changes & 16 != 0 {
            self.last[FLAGS] = self.flags.next(coder, usize::from(self.last[FLAGS]));
        }
        if changes & 8 != 0 {
            self.last[CLASS] = self.class.next(coder, usize::from(self.last[CLASS]));
        }
        if changes & 4 != 0 {
            self.last[ANGLE] = self.angle.next(coder, usize::from(size < 3), i32::from(self.last[ANGLE])) as u8;
        }
        if changes & 2 != 0 {
            self.last[USER] = self.user.next(coder, usize::from(self.last[USER]));
        }
        if changes & 1 != 0 {
            let id = self.source_id.next(coder, 0, self.short(SOURCE_ID)) as u16;
            self.last[SOURCE_ID..].copy_from_slice(&id.to_le_bytes());
        }
        field.copy_from_slice(&self.last);
        true
    }
}

/// Largest multiple of the last time difference with a symbol of its own; then follow an absolute time and no change.
const MOST_MULTIPLE: u32 = 509;
const ANEW: u32 = 510;

/// Times as the integers of their bit patterns, coded as differences from the one before.
pub(super) struct Times {
    time: i64,
    difference: i32,
    /// Number of consecutive differences far from a multiple of the last one.
    misses: u32,
    multiples: Model<512, u16>,
    /// Used if the last difference is 0: no change, a difference, an absolute time.
    still: Model<3>,
    numbers: Numbers,
}

impl Times {
    fn anew(coder: &mut Coder) -> i64 {
        (0..4).fold(0, |time, part| time | u64::from(coder.bits(16)) << (16 * part)) as i64
    }
}

impl Item for Times {
    fn new(first: &[u8]) -> Self {
        Self {
            time: first.first_chunk().map_or(0, |&eight| i64::from_le_bytes(eight)),
            difference: 0,
            misses: 0,
            multiples: Model::new(512),
            still: Model::new(3),
            numbers: Numbers::new(32, 6),
        }
    }

    fn next(&mut self, coder: &mut Coder, field: &mut [u8]) -> bool {
        if self.difference == 0 {
            match coder.symbol(&mut self.still) {
                0 => {}
                1 => {
                    self.difference = self.numbers.next(coder, 0, 0);
                    self.time = self.time.wrapping_add(self.difference.into());
                }
                _ => self.time = Self::anew(coder),
            }
        } else {
            let multiple = coder.symbol(&mut self.multiples);
            if multiple <= MOST_MULTIPLE {
                let (context, expected) = match multiple {
                    0 => (2, self.difference / 4),
                    1 => (1, self.difference),
                    2..10 => (3, self.difference.wrapping_mul(multiple as i32)),
                    10..50 => (4, self.difference.wrapping_mul(multiple as i32)),
                    _ => (5, self.difference.wrapping_mul(multiple as i32)),
                };
                let difference = self.numbers.next(coder, context, expected);
                match multiple {
                    1 => (self.difference, self.misses) = (difference, 0),
                    0 | MOST_MULTIPLE => {
                        self.misses += 1;
                        if self.misses > 3 {
                            (self.difference, self.misses) = (difference, 0);
                        }
                    }
                    _ => {}
                }
                self.time = self.time.wrapping_add(difference.into());
            } else if multiple == ANEW {
                self.time = Self::anew(coder);
            }
        }
        field.copy_from_slice(&self.time.to_le_bytes());
        true
    }
}

/// Colours: which bytes change, then their differences.
pub(super) struct Colours {
    last: [u8; COLOUR_BYTES],
    changes: Model<64>,
    bytes: Numbers,
}

impl Item for Colours {
    fn new(first: &[u8]) -> Self {
        let last = first.first_chunk().copied().unwrap_or_default();
        Self { last, changes: Model::new(64), bytes: Numbers::new(8, COLOUR_BYTES) }
    }

    fn next(&mut self, coder: &mut Coder, field: &mut [u8]) -> bool {
        let changes = coder.symbol(&mut self.changes);
        for (at, byte) in self.last.iter_mut().enumerate().filter(|(at, _)| changes >> at & 1 != 0) {
            *byte = self.bytes.next(coder, at, i32::from(*byte)) as u8;
        }
        field.copy_from_slice(&self.last);
        true
    }
}

/// Extra bytes: each as a difference from the last one.
pub(super) struct ExtraBytes {
    last: Vec<u8>,
    bytes: Numbers,
}

impl Item for ExtraBytes {
    fn new(first: &[u8]) -> Self {
        Self { last: first.to_vec(), bytes: Numbers::new(8, first.len()) }
    }

    fn next(&mut self, coder: &mut Coder, field: &mut [u8]) -> bool {
        for (at, byte) in self.last.iter_mut().enumerate() {
            *byte = self.bytes.next(coder, at, i32::from(*byte)) as u8;
        }
        field.copy_from_slice(&self.last);
        true
    }
}
