//! Loops over runs of spans, written so that the compiler vectorises them.
//!
//! Always inlined: the compiler's own choice changes with unrelated code, and without inlining a box query takes a
//! tenth longer.

use super::blocks::Kinds;
use crate::page::Span;

/// Joins `value` of all `spans` (joining a value twice must be harmless) until `done`.
///
/// Takes eight spans at a time; the last eight overlap the previous ones, which avoids a loop over the remainder. The
/// early exit keeps the compiler from vectorising across groups of eight, which costs more than it gains on runs of 10
/// to 60 spans.
#[cfg_attr(target_family = "wasm", inline)]
#[cfg_attr(not(target_family = "wasm"), inline(always))]
fn gather(
    spans: &[Span],
    value: impl Fn(Span) -> u32,
    join: impl Fn(u32, u32) -> u32,
    done: impl Fn(u32) -> bool,
) -> u32 {
    let (eights, rest) = spans.as_chunks::<8>();
    let mut all = 0;
    for group in eights {
        all = join(all, eight(group, &value, &join));
        if done(all) {
            return all;
        }
    }
    if rest.is_empty() {
        all
    } else if let Some(last) = spans.last_chunk() {
        join(all, eight(last, &value, &join))
    } else if let (Some(first), Some(last)) = (spans.first_chunk(), spans.last_chunk()) {
        join(quad(first, &value, &join), quad(last, &value, &join))
    } else {
        spans.iter().fold(0, |all, &span| join(all, value(span)))
    }
}

#[cfg_attr(target_family = "wasm", inline)]
#[cfg_attr(not(target_family = "wasm"), inline(always))]
fn quad(spans: &[Span; 4], value: impl Fn(Span) -> u32, join: impl Fn(u32, u32) -> u32) -> u32 {
    join(join(value(spans[0]), value(spans[1])), join(value(spans[2]), value(spans[3])))
}

#[cfg_attr(target_family = "wasm", inline)]
#[cfg_attr(not(target_family = "wasm"), inline(always))]
fn eight(spans: &[Span; 8], value: impl Fn(Span) -> u32, join: impl Fn(u32, u32) -> u32) -> u32 {
    // Not `map`, which is not always inlined either.
    let pair = |n: usize| join(value(spans[n]), value(spans[n + 4]));
    join(join(pair(0), pair(1)), join(pair(2), pair(3)))
}

/// Returns the classes of those `spans` that lie in lanes `x0..=x1` and meet `low..=high`. May stop once one of `until`
/// is found.
#[cfg(any(test, not(target_arch = "x86_64"), slicewalk_portable))]
#[cfg_attr(target_family = "wasm", inline)]
#[cfg_attr(not(target_family = "wasm"), inline(always))]
pub(super) fn meeting_in_lanes(spans: &[Span], x0: u32, x1: u32, low: u32, high: u32, until: Kinds) -> Kinds {
    let kinds = |span: Span| span.kinds() & select(meets(span, low, high) & in_lanes(span, x0, x1));
    gather(spans, kinds, |a, b| a | b, |all| all & until != 0)
}

/// Returns the highest top up to `limit`, plus 1, of a floor span in lanes `x0..=x1`, or 0 without one. Ends when it
/// reaches `bound`.
#[cfg_attr(target_family = "wasm", inline)]
#[cfg_attr(not(target_family = "wasm"), inline(always))]
pub(super) fn top_in_lanes(spans: &[Span], x0: u32, x1: u32, limit: u32, bound: u32) -> u32 {
    let top = |span: Span| {
        let counts = !span.is_obstacle() & (span.top() as i32 <= limit as i32) & in_lanes(span, x0, x1);
        (span.top() + 1) & select(counts)
    };
    gather(spans, top, |a, b| if a as i32 > b as i32 { a } else { b }, |all| all >= bound)
}

/// Returns `kinds` joined with the classes of those spans that meet `low..=high`.
#[cfg_attr(target_family = "wasm", inline)]
#[cfg_attr(not(target_family = "wasm"), inline(always))]
pub(super) fn meeting(quads: &[[Span; 4]], kinds: Kinds, low: u32, high: u32) -> Kinds {
    let met = |span: Span| span.kinds() & select(meets(span, low, high));
    quads.iter().fold(kinds, |kinds, group| kinds | quad(group, met, |a, b| a | b))
}

/// Signed comparisons of values below 2³¹, because baseline x86-64 has no others for vectors.
#[cfg_attr(target_family = "wasm", inline)]
#[cfg_attr(not(target_family = "wasm"), inline(always))]
fn meets(span: Span, low: u32, high: u32) -> bool {
    (span.bottom() as i32 <= high as i32) & (span.top() as i32 >= low as i32)
}

#[cfg_attr(target_family = "wasm", inline)]
#[cfg_attr(not(target_family = "wasm"), inline(always))]
fn in_lanes(span: Span, x0: u32, x1: u32) -> bool {
    (span.lane() as i32 >= x0 as i32) & (span.lane() as i32 <= x1 as i32)
}

/// Returns all bits if `condition`, else 0.
#[cfg_attr(target_family = "wasm", inline)]
#[cfg_attr(not(target_family = "wasm"), inline(always))]
pub(super) fn select(condition: bool) -> u32 {
    u32::from(condition).wrapping_neg()
}
