// Pages as meshes of graphics engines.

import assert from "node:assert/strict";
import { test } from "node:test";
import { fromYUp, pageAttributes, toYUp } from "../dist/mesh.js";
import { openArchive } from "../dist/index.js";
import { FileHost, read } from "./local.js";

const near = (found, expected, slack = 1e-5) =>
  assert.ok(
    found.length === expected.length && found.every((v, n) => Math.abs(v - expected[n]) <= slack),
    `${found}, not ${expected}`,
  );

const four = (row) => [row, row, row, row].flat();

/** The box of one cell and one step, as quads of a top and of a side towards x, at far coordinates. */
const page = {
  id: 1,
  key: { tx: 0, ty: 0, layer: 0, level: 0 },
  cell: 0.1,
  origin: [5_000_000, 400_000, 30],
  scale: [0.1, 0.1, 0.01],
  bounds: { min: [0, 0, 0], max: [0, 0, 0] },
  positions: Uint16Array.of(4, 2, 120, 5, 2, 120, 5, 3, 120, 4, 3, 120, 5, 2, 0, 5, 3, 0, 5, 3, 120, 5, 2, 120),
  normals: Int8Array.from([...four([0, 0, 127, 0]), ...four([127, 0, 0, 0])]),
  attributes: Uint8Array.from([...four([0, 0, 0, 0]), ...four([2, 1, 90, 0])]),
  indices: Uint32Array.of(0, 1, 2, 0, 2, 3, 4, 5, 6, 4, 6, 7),
};
const info = { pixelSize: 0.1, sliceHeight: 0.3 };
const origin = [4_999_999, 399_998, 29];

/** The normal of a triangle by the order of its corners. */
function facing({ positions, indices }, triangle) {
  const corner = (n) => [...positions.subarray(3 * indices[3 * triangle + n], 3 * indices[3 * triangle + n] + 3)];
  const [a, b, c] = [0, 1, 2].map(corner);
  const [u, v] = [b, c].map((p) => p.map((x, axis) => x - a[axis]));
  const cross = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
  return cross.map((x) => x / Math.hypot(...cross));
}

test("axes turn to y up and back, without a zero of another sign", () => {
  assert.deepEqual(toYUp([1, 2, 3]), [1, 3, -2]);
  assert.deepEqual(fromYUp(toYUp([1, 2, 3])), [1, 2, 3]);
  assert.deepEqual(
    [toYUp([0, 0, 0]), fromYUp([0, 0, 0])],
    [
      [0, 0, 0],
      [0, 0, 0],
    ],
  );
});

test("a page lies where the scan has it, faces outwards, and has colours of its kind", () => {
  const z = pageAttributes(page, { origin, up: "z" });
  near(z.positions.subarray(0, 3), [1.4, 2.2, 2.2]);
  near(z.normals.subarray(9), [0, 0, 1, 1, 0, 0, 1, 0, 0, 1, 0, 0, 1, 0, 0]);
  near(facing(z, 0), [0, 0, 1]);
  near(facing(z, 2), [1, 0, 0]);
  const y = pageAttributes(page, { origin, floor: [1, 0, 0], obstacle: [0, 0.5, 1] });
  for (let vertex = 0; vertex < 8; vertex++) {
    const of = (numbers) => [...numbers.subarray(3 * vertex, 3 * vertex + 3)];
    near(of(y.positions), toYUp(of(z.positions)));
    near(of(y.normals), toYUp(of(z.normals)));
  }
  near(facing(y, 1), [0, 1, 0]);
  near(facing(y, 3), [1, 0, 0]);
  near(y.colours.subarray(0, 4), [1, 0, 0, 1]);
  near(y.colours.subarray(28), [0, 128 / 255, 1, 1]);
  near(pageAttributes(page, { origin, obstacle: [0, 0.5, 1], linear: true }).colours.subarray(28), [0, 0.2158605, 1, 1]);
  assert.equal(y.indices, page.indices);
});

test("a vertex has the colour of the voxel behind it", () => {
  const cells = new Uint32Array(4 * 64 * 64);
  // Slices 0, 3 and 40 of the cell under the top; the top lies at the end of slice 3.
  cells.set([0b1001, 1 << 8, 1, 0], 4 * (64 * 2 + 4));
  const colours = Uint8Array.of(9, 9, 9, 255, 255, 0, 0, 255, 0, 255, 0, 255, 0, 0, 255, 255);
  const scan = { colours: { id: 1, edge: 64, cells, colours }, info };
  const painted = pageAttributes(page, { origin, scan }).colours;
  for (const vertex of [0, 1, 2, 3, 6, 7]) near(painted.subarray(4 * vertex, 4 * vertex + 4), [0, 1, 0, 1]);
  for (const vertex of [4, 5]) near(painted.subarray(4 * vertex, 4 * vertex + 4), [1, 0, 0, 1]);
  // A hole that the mesh closes has the colour beside it.
  const hole = { ...page, positions: page.positions.map((v, n) => (n % 3 === 0 ? v + 2 : v)) };
  near(pageAttributes(hole, { origin, scan }).colours.subarray(0, 4), [0, 1, 0, 1]);
  const away = { ...page, positions: page.positions.map((v, n) => (n % 3 === 0 ? v + 3 : v)) };
  near(pageAttributes(away, { origin, scan, floor: [0, 1, 1] }).colours.subarray(0, 4), [0, 1, 1, 1]);
  // Slice 40 alone is too far away, above 31 it is found where it belongs.
  cells.set([0, 1 << 8, 3, 0], 4 * (64 * 2 + 4));
  near(pageAttributes(page, { origin, scan, floor: [0, 1, 1] }).colours.subarray(0, 4), [0, 1, 1, 1]);
  const high = { ...page, positions: page.positions.map((v, n) => (n % 3 === 2 && v === 120 ? 1230 : v)) };
  near(pageAttributes(high, { origin, scan }).colours.subarray(0, 4), [0, 0, 1, 1]);
});

test("pages of an archive, fine and coarse, become meshes within their bounds", async () => {
  const archive = await openArchive("http://host/levels.slices", { worker: new FileHost(read("levels.slices")).worker });
  const pages = new Map();
  const view = archive.view({ radius: 4, overview: true, onPage: (page) => pages.set(page.id, page), onDrop: () => undefined });
  view.look([0, 0, 1]);
  while ([...pages.values()].every(({ key }) => key.level === 0) || pages.size < 8) {
    await new Promise((resolve) => setTimeout(resolve, 5));
  }
  for (const page of pages.values()) {
    const { positions, normals } = pageAttributes(page, { origin: [0, 0, 0], up: "z" });
    for (let at = 0; at < positions.length; at++) {
      const [low, high] = [page.bounds.min[at % 3], page.bounds.max[at % 3]];
      assert.ok(positions[at] >= low - page.cell - 1e-5 && positions[at] <= high + page.cell + 1e-5);
    }
    for (let at = 0; at < normals.length; at += 3) near([Math.hypot(...normals.subarray(at, at + 3))], [1]);
  }
  archive.close();
});
