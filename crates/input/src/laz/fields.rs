//! Fields that points of all formats pack alike: coordinates, bytes in the context of earlier ones, colours, times.

use super::coder::{Coder, Median, Model, Numbers};

/// Bytes of a time; below, of a colour.
pub(super) const TIME_BYTES: usize = 8;
pub(super) const COLOUR_BYTES: usize = 6;

/// Coordinates: x and y as steps from the last point, z as a difference from an expected height.
pub(super) struct Coordinates {
    x: i32,
    y: i32,
    z: i32,
    dx: Numbers,
    dy: Numbers,
    dz: Numbers,
}

impl Coordinates {
    pub const MOST_STEPS: usize = 3 * Numbers::MOST_STEPS;

    /// Creates the state after the `first` record.
    pub fn new(first: &[u8]) -> Self {
        let number = |at: usize| first[at..].first_chunk().map_or(0, |&four| i32::from_le_bytes(four));
        let [dx, dy, dz] = [2, 22, 20].map(|contexts| Numbers::new(32, contexts));
        Self { x: number(0), y: number(4), z: number(8), dx, dy, dz }
    }

    pub fn z(&self) -> i32 {
        self.z
    }

    /// Decodes the next x and y, predicted from the last `steps` of the same kind; `single`: the pulse has one return.
    #[inline(always)]
    pub fn next_xy(&mut self, coder: &mut Coder, [step_x, step_y]: &mut [Median; 2], single: bool) {
        let dx = self.dx.next(coder, usize::from(single), step_x.get());
        step_x.add(dx);
        self.x = self.x.wrapping_add(dx);
        let context = (self.dx.size() & !1).min(20) as usize + usize::from(single);
        let dy = self.dy.next(coder, context, step_y.get());
        step_y.add(dy);
        self.y = self.y.wrapping_add(dy);
    }

    /// Decodes the next z, after x and y. It is predicted to be the last `height` of the same kind, and replaces that.
    #[inline(always)]
    pub fn next_z(&mut self, coder: &mut Coder, height: &mut i32, single: bool) {
        let context = (((self.dx.size() + self.dy.size()) / 2) & !1).min(18) as usize + usize::from(single);
        self.z = self.dz.next(coder, context, *height);
        *height = self.z;
    }

    #[inline(always)]
    pub fn write(&self, record: &mut [u8]) {
        for (to, from) in record.chunks_exact_mut(4).zip([self.x, self.y, self.z]) {
            to.copy_from_slice(&from.to_le_bytes());
        }
    }
}

/// Models by context, each created when its context first occurs.
pub(super) struct Lazily {
    models: Box<[Option<Box<Model<256>>>]>,
    symbols: usize,
}

impl Lazily {
    /// Creates `models` contexts for models of `symbols` symbols.
    pub fn new(models: usize, symbols: usize) -> Self {
        Self { models: (0..models).map(|_| None).collect(), symbols }
    }

    /// Decodes the next byte in the context `before`.
    #[inline(always)]
    pub fn next(&mut self, coder: &mut Coder, before: usize) -> u8 {
        let model = self.models[before].get_or_insert_with(|| Box::new(Model::new(self.symbols)));
        coder.symbol(model) as u8
    }
}

/// Colours: the lower, then the upper byte of red, green and blue.
pub(super) struct Colours {
    changes: Model<128>,
    bytes: [Model<256>; COLOUR_BYTES],
}

impl Colours {
    pub const MOST_STEPS: usize = 1 + COLOUR_BYTES;

    pub fn new() -> Self {
        let byte = Model::new(256);
        Self { changes: Model::new(128), bytes: std::array::from_fn(|_| byte.clone()) }
    }

    /// Decodes the colour after `last`.
    #[inline(always)]
    pub fn next(&mut self, coder: &mut Coder, last: [u8; COLOUR_BYTES]) -> [u8; COLOUR_BYTES] {
        let changes = coder.symbol(&mut self.changes);
        let mut now = last;
        let mut changed = |at: usize, expected: u8| {
            let changed = changes >> at & 1 != 0;
            changed.then(|| expected.wrapping_add(coder.symbol(&mut self.bytes[at]) as u8))
        };
        for red in 0..2 {
            now[red] = changed(red, last[red]).unwrap_or(last[red]);
        }
        if changes & 64 == 0 {
            let [lower, upper, ..] = now;
            return [lower, upper, lower, upper, lower, upper];
        }
        for red in 0..2 {
            // Green and blue are expected to change as red did.
            let (green, blue) = (red + 2, red + 4);
            let change = |at: usize, now: u8| i32::from(now) - i32::from(last[at]);
            let with = |at: usize, by: i32| (i32::from(last[at]) + by).clamp(0, 255) as u8;
            let by = change(red, now[red]);
            now[green] = changed(green, with(green, by)).unwrap_or(last[green]);
            let by = (by + change(green, now[green])) / 2;
            now[blue] = changed(blue, with(blue, by)).unwrap_or(last[blue]);
        }
        now
    }
}

/// Largest multiple of the last time difference with a symbol of its own; below, the least one.
const MOST_MULTIPLE: i32 = 500;
const LEAST_MULTIPLE: i32 = -10;
const UNCHANGED: i32 = MOST_MULTIPLE - LEAST_MULTIPLE + 1;
const ANEW: i32 = UNCHANGED + 1;
/// Number of time sequences that alternate.
const SEQUENCES: usize = 4;

/// Times as the integers of their bit patterns.
pub(super) struct Times {
    sequences: [TimeSequence; SEQUENCES],
    last: usize,
    newest: usize,
    repeats: bool,
    multiples: Model<516, u16>,
    /// Used if the last difference is 0.
    still: Model<6>,
    numbers: Numbers,
}

/// One sequence of times.
#[derive(Clone, Copy, Default)]
struct TimeSequence {
    time: i64,
    difference: i32,
    /// Number of consecutive differences far from a multiple of the last one.
    misses: u32,
}

impl Times {
    pub const MOST_STEPS: usize = SEQUENCES + 1 + Numbers::MOST_STEPS + 2;

    /// Creates times that follow `first`; `repeats`: a time equal to the last one has a symbol of its own.
    pub fn new(first: i64, repeats: bool) -> Self {
        let mut sequences = [TimeSequence::default(); SEQUENCES];
        sequences[0].time = first;
        Self {
            sequences,
            last: 0,
            newest: 0,
            repeats,
            multiples: Model::new(515 + usize::from(repeats)),
            still: Model::new(5 + usize::from(repeats)),
            numbers: Numbers::new(32, 9),
        }
    }

    pub fn last(&self) -> i64 {
        self.sequences[self.last].time
    }

    /// Decodes the next time; returns whether a writer can have written its bytes: it changes to another sequence once.
    #[inline(never)]
    pub fn next<'a>(&mut self, mut coder: Coder<'a>) -> (Coder<'a>, bool) {
        let no_repeats = i32::from(!self.repeats);
        for _ in 0..SEQUENCES {
            let sequence = &mut self.sequences[self.last];
            let symbol = match sequence.difference {
                0 => match coder.symbol(&mut self.still) as i32 + no_repeats {
                    0 => UNCHANGED,
                    1 => {
                        let difference = self.numbers.next(&mut coder, 0, 0);
                        *sequence = TimeSequence { time: sequence.after(difference), difference, misses: 0 };
                        return (coder, true);
                    }
                    symbol => ANEW - 2 + symbol,
                },
                _ => match coder.symbol(&mut self.multiples) as i32 {
                    symbol @ UNCHANGED.. => symbol + no_repeats,
                    symbol => symbol,
                },
            };
            match symbol {
                UNCHANGED => return (coder, true),
                ..UNCHANGED => {
                    let (multiple, context) = match symbol {
                        0 => (0, 7),
                        1 => (1, 1),
                        2..10 => (symbol, 2),
                        10..MOST_MULTIPLE => (symbol, 3),
                        MOST_MULTIPLE => (symbol, 4),
                        _ if MOST_MULTIPLE - symbol > LEAST_MULTIPLE => (MOST_MULTIPLE - symbol, 5),
                        _ => (LEAST_MULTIPLE, 6),
                    };
                    let expected = sequence.difference.wrapping_mul(multiple);
                    let difference = self.numbers.next(&mut coder, context, expected);
                    sequence.time = sequence.after(difference);
                    match multiple {
                        1 => sequence.misses = 0,
                        0 | LEAST_MULTIPLE | MOST_MULTIPLE => {
                            sequence.misses += 1;
                            if sequence.misses > 3 {
                                (sequence.difference, sequence.misses) = (difference, 0);
                            }
                        }
                        _ => {}
                    }
                    return (coder, true);
                }
                ANEW => {
                    let upper = self.numbers.next(&mut coder, 8, (sequence.time >> 32) as i32);
                    let lower = coder.bits(16) | coder.bits(16) << 16;
                    self.newest = (self.newest + 1) % SEQUENCES;
                    self.last = self.newest;
                    let time = i64::from(upper) << 32 | i64::from(lower);
                    self.sequences[self.last] = TimeSequence { time, ..TimeSequence::default() };
                    return (coder, true);
                }
                _ => self.last = (self.last + (symbol - ANEW) as usize) % SEQUENCES,
            }
        }
        (coder, false)
    }
}

impl TimeSequence {
    fn after(&self, difference: i32) -> i64 {
        self.time.wrapping_add(i64::from(difference))
    }
}
