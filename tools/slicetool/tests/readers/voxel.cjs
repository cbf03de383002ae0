// Reads NAME.voxel.json and its words by SuperSplat's own class, and writes NAME.voxel.txt: x, y, z of every solid voxel, counted
// from the origin, with z up. `node voxel.cjs MODULES NAME`. The viewer exports no reader, so its class is cut out of the bundle.
const { readFileSync, writeFileSync } = require("node:fs");
const { join } = require("node:path");

const [modules, name] = process.argv.slice(2);
const bundle = readFileSync(join(modules, "@playcanvas/supersplat-viewer/dist/viewer.js"), "utf8");
const start = bundle.indexOf("const SOLID_LEAF_MARKER");
const end = bundle.indexOf("\n}\n", bundle.indexOf("class VoxelCollision {"));
if (start < 0 || end < start) throw new Error("SuperSplat's viewer has no class VoxelCollision any more");
const VoxelCollision = new Function(`${bundle.slice(start, end + 2)}; return VoxelCollision;`)();

const head = JSON.parse(readFileSync(`${name}.voxel.json`, "utf8"));
const bytes = readFileSync(`${name}.voxel.bin`);
const words = new Uint32Array(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length));
const collision = new VoxelCollision(head, words.slice(0, head.nodeCount), words.slice(head.nodeCount));
const first = head.gridBounds.min.map((v) => Math.round(v / head.voxelResolution));
const lines = [];
for (let z = 0; z < collision.numVoxelsZ; z++) {
    for (let y = 0; y < collision.numVoxelsY; y++) {
        for (let x = 0; x < collision.numVoxelsX; x++) {
            if (collision.isVoxelSolid(x, y, z)) lines.push(`${x + first[0]} ${-(z + first[2]) - 1} ${y + first[1]}`);
        }
    }
}
writeFileSync(`${name}.voxel.txt`, `${lines.join("\n")}\n`);
