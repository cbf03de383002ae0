// Pages on the device, and the words of a batch. Every other shader of this folder is appended to this text.
//
// All positions count from the scene's first tile and lowest layer: pixels, and quanta of height.

const PAGE_QUANTA: i32 = 16320;
const SLICE_QUANTA: u32 = 255u;
const FIELD: u32 = 0x3fffu;
const OBSTACLE: u32 = 0x10000000u;
const NONE: u32 = 0xffffffffu;

// Answers of shapes. No answer of any kind is 0, which stands for a question that was not reached.
const CLEAR: u32 = 1u;
const HIT: u32 = 2u;
const NOT_LOADED: u32 = 3u;
const UNDECIDED: u32 = 4u;

struct Batch {
    // Number of questions.
    count: u32,
    // Number of buckets, a power of two, minus 1.
    buckets: u32,
    // Number of tiles along x and y.
    tiles: vec2<i32>,
    // Height of a quantum in pixels.
    quantum: f32,
    // Most steps of loops that a question may take.
    budget: u32,
}

// Tile columns by place: tile x, tile y, first slot, number of slots (0 in a free bucket).
@group(0) @binding(0) var<storage, read> buckets: array<vec4<u32>>;
// Pages by column, lowest first: layer, occupied slices (low and high half), first word (NONE: not in memory).
@group(0) @binding(1) var<storage, read> slots: array<vec4<u32>>;
// A page: mask of occupied blocks (two words), then a record for each of them, then their unions and spans.
@group(0) @binding(2) var<storage, read> words: array<u32>;
@group(0) @binding(3) var<uniform> batch: Batch;
@group(0) @binding(4) var<storage, read> questions: array<u32>;
@group(0) @binding(5) var<storage, read_write> answers: array<u32>;

// Steps of loops so far. Every loop counts its steps and ends when they exceed the budget; the answer is then undecided.
// Some drivers end loops by themselves after a number of steps, without an error, and others reset the device.
var<private> spent: u32;

fn is_spent() -> bool {
    spent++;
    return spent > batch.budget;
}

fn integer(at: u32) -> i32 {
    return bitcast<i32>(questions[at]);
}

fn real(at: u32) -> f32 {
    return bitcast<f32>(questions[at]);
}

// First slot of a tile column, and the number of its slots.
fn column_of(tx: i32, ty: i32) -> vec2<u32> {
    let x = bitcast<u32>(tx);
    let y = bitcast<u32>(ty);
    var at = x * 0x9e3779b1u + y * 0x85ebca77u;
    at = (at ^ (at >> 15u)) & batch.buckets;
    // At least half of the buckets are free, so the loop ends early.
    for (var tried = 0u; tried <= batch.buckets; tried++) {
        if is_spent() {
            break;
        }
        let bucket = buckets[at];
        if bucket.w == 0u {
            break;
        }
        if bucket.x == x && bucket.y == y {
            return bucket.zw;
        }
        at = (at + 1u) & batch.buckets;
    }
    return vec2<u32>(0u, 0u);
}

// Mask of the slices in which a span can lie that meets the local heights `low` to `high`.
fn slices_between(low: u32, high: u32) -> vec2<u32> {
    let first = (max(low, 1u) - 1u) / SLICE_QUANTA;
    let last = min(high / SLICE_QUANTA, 63u);
    let above = vec2<u32>(select(0u, NONE << (first & 31u), first < 32u), select(NONE << (first & 31u), NONE, first < 32u));
    let below = vec2<u32>(select(NONE, NONE >> (31u - (last & 31u)), last < 32u), select(NONE >> (31u - (last & 31u)), 0u, last < 32u));
    return above & below;
}

// Whether a page can hold a span that meets heights `low` to `high`.
fn is_near(base: i32, low: i32, high: i32) -> bool {
    return base + PAGE_QUANTA >= low && base <= high;
}

// Converts a height to one above the floor of a page, clamped to the page.
fn local(height: i32, base: i32) -> u32 {
    return u32(clamp(height - base, 0, PAGE_QUANTA));
}

// Whether a page is occupied between local heights.
fn is_occupied(slot: vec4<u32>, low: u32, high: u32) -> bool {
    return any((slot.yz & slices_between(low, high)) != vec2<u32>(0u, 0u));
}

// Record of block `number` (8 * y + x) of a page; NONE without one. Its words: occupied pixels (low and high half), first
// word of the unions, number of unions and number of spans (high half), where each row's spans begin (16 bits each).
fn record_of(page: u32, number: u32) -> u32 {
    let low = words[page];
    let bit = 1u << (number & 31u);
    if number < 32u {
        return select(NONE, page + 2u + 8u * countOneBits(low & (bit - 1u)), (low & bit) != 0u);
    }
    let high = words[page + 1u];
    return select(NONE, page + 2u + 8u * (countOneBits(low) + countOneBits(high & (bit - 1u))), (high & bit) != 0u);
}

fn bottom_of(span: u32) -> u32 {
    return span & FIELD;
}

fn top_of(span: u32) -> u32 {
    return (span >> 14u) & FIELD;
}

// x % 8 of the span's pixel.
fn lane_of(span: u32) -> u32 {
    return span >> 29u;
}

fn meets(span: u32, low: u32, high: u32) -> bool {
    return bottom_of(span) <= high && top_of(span) >= low;
}

// Whether the spans of any pixel of a block meet the local heights. Unions ascend by their bottom.
fn unions_meet(record: u32, low: u32, high: u32) -> bool {
    let first = words[record + 2u];
    let end = first + (words[record + 3u] & 0xffffu);
    for (var at = first; at < end; at++) {
        if is_spent() {
            break;
        }
        let span = words[at];
        if bottom_of(span) > high {
            break;
        }
        if top_of(span) >= low {
            return true;
        }
    }
    return false;
}

// First word of the spans of row `y` of a block; row 8 is the end of the last row.
fn row_of(record: u32, y: u32) -> u32 {
    let counts = words[record + 3u];
    let spans = words[record + 2u] + (counts & 0xffffu);
    if y > 7u {
        return spans + (counts >> 16u);
    }
    return spans + ((words[record + 4u + (y >> 1u)] >> (16u * (y & 1u))) & 0xffffu);
}

// Part of `ends` (first, last) in the cells `origin` to `origin + count - 1`, counted from `origin`.
fn part(ends: vec2<i32>, origin: i32, count: i32) -> vec2<u32> {
    return vec2<u32>(clamp(ends - vec2<i32>(origin), vec2<i32>(0), vec2<i32>(count - 1)));
}
