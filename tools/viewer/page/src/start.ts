// Chooses the start of a walk if the address does not: on a floor near the middle with room to stand, looking into open
// space.

import { CLEAR, type Archive, type Vec3 } from "slicewalk";
import { clamp, direction, flat, standing, type Look } from "./geometry";
import type { Settings } from "./settings";

/** Number of places tried, from the middle outwards, and of heights tried at each. */
const SPIRAL = 49;
const MOST_HEIGHTS = 24;
/** Height above a floor from which it counts as free, because it is stored to a quantum. */
const ABOVE_FLOOR_M = 0.02;
/** A direction is rated by its free distance, up to this one; directions into the open get a fixed rating. */
const VIEW_M = 25;
const OPEN_M = 4;
const EYE_BOX_M = 0.2;

function* spiral(): Generator<readonly [number, number]> {
  let [x, y, dx, dy] = [0, 0, 0, -1];
  for (let n = 0; n < SPIRAL; n++) {
    yield [x, y];
    if (x === y || (x < 0 && x === -y) || (x > 0 && x === 1 - y)) [dx, dy] = [-dy, dx];
    x += dx;
    y += dy;
  }
}

export async function findStart(archive: Archive, settings: Settings, signal: AbortSignal): Promise<Vec3 | null> {
  const { bounds, pixelSize, sliceHeight } = archive.info;
  if (bounds === null) return null;
  const { min, max } = bounds;
  const span = Math.min(max[0] - min[0], max[1] - min[1]);
  const stride = clamp(span / 9, Math.min(2 * settings.width, span / 9), 8);
  const storeys = clamp(Math.ceil((max[2] - min[2]) / 1.5), 1, MOST_HEIGHTS);
  // Heads at these heights, from the ground up: the lowest floor with room is the ground floor.
  const tops = Array.from({ length: storeys }, (_, n) => min[2] + ((n + 1) * (max[2] - min[2])) / storeys + sliceHeight);
  for (const [across, along] of spiral()) {
    const x = (min[0] + max[0]) / 2 + across * stride;
    const y = (min[1] + max[1]) / 2 + along * stride;
    if (x < min[0] || x > max[0] || y < min[1] || y > max[1]) continue;
    const half = pixelSize / 2;
    const probes = tops.flatMap((top) => [x - half, y - half, top - sliceHeight, x + half, y + half, top]);
    const floors = await archive.floor(new Float64Array(probes), { load: true, signal });
    const heights = [...new Set(floors)].filter(Number.isFinite);
    if (heights.length === 0) continue;
    const rooms = heights.flatMap((z) => flat(standing([x, y, z + ABOVE_FLOOR_M], settings.width, settings.height)));
    const free = await archive.overlaps(new Float64Array(rooms), { load: true, signal });
    const found = heights.find((_, n) => free[n] === CLEAR);
    if (found !== undefined) return [x, y, found];
  }
  return null;
}

/** Looks along the longest free view: sweeps a small box, which unlike a ray does not slip through sparse walls. */
export async function findLook(archive: Archive, at: Vec3, eye: number): Promise<Look> {
  const headings = Array.from({ length: 24 }, (_, n) => n * 15);
  const box = flat(standing([at[0], at[1], at[2] + eye - EYE_BOX_M / 2], EYE_BOX_M, EYE_BOX_M));
  const sweeps = headings.flatMap((heading) => [...box, ...direction({ heading, pitch: 0 }).map((way) => way * VIEW_M)]);
  const shares = await archive.sweep(new Float64Array(sweeps));
  let best = { heading: 0, far: -1 };
  headings.forEach((heading, n) => {
    // Out of the scan, or into pages that are not loaded, there is less to see than along a room.
    const share = shares[n] ?? NaN;
    const far = share < 1 ? share * VIEW_M : OPEN_M;
    if (far > best.far) best = { heading, far };
  });
  return { heading: best.heading, pitch: 0 };
}
