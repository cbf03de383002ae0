//! Waveform descriptions (item `WAVEPACKET13` of LASzip), in one sequence with the fields of points of formats 4 and 5.

use super::coder::{Coder, Model, Numbers};
use super::sequence::Item;

/// Bytes of a description: number of the packet's kind, offset, size, location of the return, direction.
pub(super) const PACKET_BYTES: usize = 29;
const PLACE: usize = 1;
const SIZE: usize = 9;
const RETURN: usize = 13;
const DIRECTION: usize = 17;

/// Offset of the next packet: the same, after the last packet, a number of bytes away, or (any other symbol) absolute.
const SAME: u32 = 0;
const BEHIND: u32 = 1;
const AWAY: u32 = 2;

pub(super) struct WavePackets {
    last: [u8; PACKET_BYTES],
    kind: Model<256>,
    /// How the offset follows the last one; context: how that followed the one before.
    follows: [Model<4>; 4],
    followed: u32,
    difference: i32,
    differences: Numbers,
    size: Numbers,
    place_of_return: Numbers,
    direction: Numbers,
}

impl WavePackets {
    pub const MOST_STEPS: usize = 2 + 6 * Numbers::MOST_STEPS;

    fn number(&self, at: usize) -> i32 {
        self.last[at..].first_chunk().map_or(0, |&four| i32::from_le_bytes(four))
    }

    fn place(&self) -> u64 {
        self.last[PLACE..].first_chunk().map_or(0, |&eight| u64::from_le_bytes(eight))
    }
}

impl Item for WavePackets {
    fn new(first: &[u8]) -> Self {
        Self {
            last: first.first_chunk().copied().unwrap_or([0; PACKET_BYTES]),
            kind: Model::new(256),
            follows: std::array::from_fn(|_| Model::new(4)),
            followed: SAME,
            difference: 0,
            differences: Numbers::new(32, 1),
            size: Numbers::new(32, 1),
            place_of_return: Numbers::new(32, 1),
            direction: Numbers::new(32, 3),
        }
    }

    #[inline(never)]
    fn next(&mut self, coder: &mut Coder, field: &mut [u8]) -> bool {
        let kind = coder.symbol(&mut self.kind) as u8;
        self.followed = coder.symbol(&mut self.follows[self.followed as usize]);
        let place = match self.followed {
            SAME => self.place(),
            BEHIND => self.place().wrapping_add(u64::from(self.number(SIZE) as u32)),
            AWAY => {
                self.difference = self.differences.next(coder, 0, self.difference);
                self.place().wrapping_add_signed(i64::from(self.difference))
            }
            _ => (0..4).fold(0, |place, part| place | u64::from(coder.bits(16)) << (16 * part)),
        };
        let mut numbers = [0; 5];
        numbers[0] = self.size.next(coder, 0, self.number(SIZE));
        numbers[1] = self.place_of_return.next(coder, 0, self.number(RETURN));
        for axis in 0..3 {
            numbers[2 + axis] = self.direction.next(coder, axis, self.number(DIRECTION + 4 * axis));
        }
        self.last[0] = kind;
        self.last[PLACE..SIZE].copy_from_slice(&place.to_le_bytes());
        self.last[SIZE..].copy_from_slice(numbers.map(i32::to_le_bytes).as_flattened());
        field.copy_from_slice(&self.last);
        true
    }
}
