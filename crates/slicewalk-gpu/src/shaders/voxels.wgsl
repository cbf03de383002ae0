// Records of points to voxels: least and greatest heights, counts and sums, by integer atomics alone. Neither the order of
// the records nor that of the threads changes them.
//
// A record is two words, low one first. From the highest bits down it holds 13 bits of the pixel, 24 of the slice, 13 of
// the height in the slice, and 7 each of the position in the pixel along x and y.

const SLICE_STEPS: u32 = 8160u;
const BIN_STEPS: u32 = 510u;
// Words of a voxel: its column, its key, the height that its least one lacks of `SLICE_STEPS`, its greatest height, bins,
// number of points, then nine sums of two words each.
const VOXEL: u32 = 24u;
const SUMS: u32 = 6u;
// Bits of a key below the pixel: the slice above the lowest of its column.
const SLICE_BITS: u32 = 19u;

struct Job {
    records: u32,
    columns: u32,
    // Slices of a band.
    band: u32,
}

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> records: array<vec2<u32>>;
// End of the column's records, first entry of its table, number of entries (a power of two) minus 1, lowest slice.
@group(0) @binding(2) var<storage, read> columns: array<vec4<u32>>;
// Entries: the key plus 1 (0 if free), and the number of the voxel.
@group(0) @binding(3) var<storage, read_write> table: array<atomic<u32>>;
// Number of voxels, then the voxels.
@group(0) @binding(4) var<storage, read_write> voxels: array<atomic<u32>>;

fn column_of(record: u32) -> u32 {
    var low = 0u;
    var high = job.columns - 1u;
    while low < high {
        let middle = (low + high) / 2u;
        if record < columns[middle].x {
            high = middle;
        } else {
            low = middle + 1u;
        }
    }
    return low;
}

fn slice_of(record: vec2<u32>) -> u32 {
    return ((record.y & 0x7ffffu) << 5u) | (record.x >> 27u);
}

fn key_of(record: vec2<u32>, lowest: u32) -> u32 {
    return ((record.y >> 19u) << SLICE_BITS) | (slice_of(record) - lowest);
}

fn first_entry(key: u32, mask: u32) -> u32 {
    let mixed = key * 0x9e3779b1u;
    return (mixed ^ (mixed >> 16u)) & mask;
}

// Gives each voxel a number.
@compute @workgroup_size(64)
fn number_voxels(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= job.records {
        return;
    }
    let number = column_of(id.x);
    let column = columns[number];
    let key = key_of(records[id.x], column.w);
    var at = first_entry(key, column.z);
    // At least half of the entries stay free.
    loop {
        let entry = 2u * (column.y + at);
        let seen = atomicLoad(&table[entry]);
        if seen == key + 1u {
            break;
        }
        if seen != 0u {
            at = (at + 1u) & column.z;
            continue;
        }
        let swapped = atomicCompareExchangeWeak(&table[entry], 0u, key + 1u);
        if swapped.exchanged {
            let voxel = atomicAdd(&voxels[0], 1u);
            atomicStore(&table[entry + 1u], voxel);
            atomicStore(&voxels[1u + VOXEL * voxel], number);
            atomicStore(&voxels[2u + VOXEL * voxel], key);
            break;
        }
        // Another thread was faster, perhaps with the same key: look again.
    }
}

// Adds to a sum of two words.
fn add(at: u32, value: u32) {
    let before = atomicAdd(&voxels[at], value);
    if before + value < before {
        atomicAdd(&voxels[at + 1u], 1u);
    }
}

// Adds each point to its voxel.
@compute @workgroup_size(64)
fn add_points(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= job.records {
        return;
    }
    let record = records[id.x];
    let column = columns[column_of(id.x)];
    let key = key_of(record, column.w);
    var at = first_entry(key, column.z);
    while atomicLoad(&table[2u * (column.y + at)]) != key + 1u {
        at = (at + 1u) & column.z;
    }
    // Some drivers end loops by themselves. The processor counts the points.
    if atomicLoad(&table[2u * (column.y + at)]) != key + 1u {
        return;
    }
    let voxel = 1u + VOXEL * atomicLoad(&table[2u * (column.y + at) + 1u]);
    let height = (record.x >> 14u) & 0x1fffu;
    let u = (record.x >> 7u) & 0x7fu;
    let v = record.x & 0x7fu;
    let w = ((slice_of(record) % job.band) * SLICE_STEPS + height) / job.band;
    atomicMax(&voxels[voxel + 2u], SLICE_STEPS - height);
    atomicMax(&voxels[voxel + 3u], height);
    atomicOr(&voxels[voxel + 4u], 1u << (height / BIN_STEPS));
    atomicAdd(&voxels[voxel + 5u], 1u);
    add(voxel + SUMS, u);
    add(voxel + SUMS + 2u, v);
    add(voxel + SUMS + 4u, w);
    add(voxel + SUMS + 6u, u * u);
    add(voxel + SUMS + 8u, u * v);
    add(voxel + SUMS + 10u, v * v);
    add(voxel + SUMS + 12u, u * w);
    add(voxel + SUMS + 14u, v * w);
    add(voxel + SUMS + 16u, w * w);
}
