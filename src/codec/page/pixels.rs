//! Occupied pixels: blocks first, then single pixels in blocks that are neither empty nor full.

use super::models::Models;
use crate::codec::Violation;
use crate::codec::interleaved::{Bit, Strands};
use crate::page::Page;

/// Codes the occupied pixels and returns a mask for each row.
#[inline(always)]
pub fn occupancy<C: Strands>(coder: &mut C, models: &mut Models, given: Option<&Page>) -> Result<[u64; 64], Violation> {
    let pixels_given = |block: u32| given.map_or(0, |page| page.block_at(block).pixels());
    let (mut matter, mut full) = (0u64, 0u64);
    for block in 0..64 {
        let kind = |exists: bool, back: u32| {
            if exists { (matter >> (block - back) & 1) as usize + (full >> (block - back) & 1) as usize } else { 0 }
        };
        let context = kind(block % 8 > 0, 1) * 3 + kind(block >= 8, 8);
        let pixels = pixels_given(block);
        coder.refill();
        if coder.bit::<0>(&mut models.matter[context], pixels != 0) {
            matter |= 1 << block;
            full |= u64::from(coder.bit::<1>(&mut models.full[context], pixels == u64::MAX)) << block;
        }
    }
    if matter == 0 {
        return Err(Violation::new("P6", "matter in some pixel", "none"));
    }
    let mut rows = [0u64; 64];
    for py in 0..64usize {
        let north = |back: usize| py.checked_sub(back).map_or(0, |north| rows[north]);
        let (north, north_2) = (north(1), north(2));
        let mut row = 0u64;
        for bx in 0..8 {
            let block = py as u32 / 8 * 8 + bx;
            if matter >> block & 1 == 0 {
                continue;
            }
            if full >> block & 1 == 1 {
                row |= 0xFF << (8 * bx);
                continue;
            }
            let pixels = (pixels_given(block) >> (8 * (py % 8))) as u32;
            // From the pixel west of the block on, without pixels outside the page.
            let from_west = |row: u64| {
                row.rotate_right((8 * bx + 63) & 63) as u32
                    & if bx == 0 { !1 } else { !0 }
                    & if bx == 7 { 0x1FF } else { !0 }
            };
            let (north, north_2) = (from_west(north), (north_2 >> (8 * bx)) as u32);
            let (mut west, mut found) = (row.rotate_right((8 * bx + 62) & 63) as u32 & 3, 0u32);
            let mut pixel = |coder: &mut C, x: u32, code: fn(&mut C, &mut Bit, bool) -> bool| {
                let context = west | (north >> x & 7) << 2 | (north_2 >> x & 1) << 5;
                let has = u32::from(code(coder, &mut models.pixel[context as usize & 63], pixels >> x & 1 == 1));
                west = west >> 1 | has << 1;
                found |= has << x;
            };
            for four in [0, 4] {
                coder.refill();
                pixel(coder, four, C::bit::<0>);
                pixel(coder, four + 1, C::bit::<1>);
                pixel(coder, four + 2, C::bit::<0>);
                pixel(coder, four + 3, C::bit::<1>);
            }
            row |= u64::from(found & 0xFF) << (8 * bx);
        }
        rows[py] = row;
    }
    Ok(rows)
}
