// Spans as pixels of a stencil, and pawns as rectangles that are tested against it.

struct Draw {
    // Added to a pixel of the tile, gives its pixel in the target.
    offset: vec2<i32>,
    // Lowest and highest height above the page's floor.
    heights: vec2<u32>,
    // Pixels of the target.
    size: vec2<f32>,
}

// Pixel in the tile (x + 64 y), and the span's bottom and top (14 bits each).
@group(0) @binding(0) var<storage, read> spans: array<vec2<u32>>;
@group(0) @binding(1) var<uniform> draw: Draw;

@vertex
fn span_corner(@builtin(vertex_index) corner: u32, @builtin(instance_index) number: u32) -> @builtin(position) vec4<f32> {
    let span = spans[number];
    let bottom = span.y & 0x3fffu;
    let top = (span.y >> 14u) & 0x3fffu;
    if bottom > draw.heights.y || top < draw.heights.x {
        // All corners in one place: nothing is drawn.
        return vec4<f32>(2.0, 2.0, 0.0, 1.0);
    }
    let pixel = vec2<i32>(vec2<u32>(span.x & 63u, span.x >> 6u)) + draw.offset;
    let at = (vec2<f32>(pixel) + vec2<f32>(vec2<u32>(corner & 1u, corner >> 1u))) / draw.size;
    return vec4<f32>(2.0 * at.x - 1.0, 1.0 - 2.0 * at.y, 0.0, 1.0);
}

// Covers the whole target; the scissor leaves the pawn's footprint.
@vertex
fn target_corner(@builtin(vertex_index) corner: u32) -> @builtin(position) vec4<f32> {
    return vec4<f32>(f32(corner & 1u) * 2.0 - 1.0, f32(corner >> 1u) * 2.0 - 1.0, 0.0, 1.0);
}
