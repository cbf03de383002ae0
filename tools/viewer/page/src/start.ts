// Where a walk begins: quickly, on some floor with room; and at leisure, where most of the scan is seen.

import { CLEAR, type Archive, type Bounds, type Vec3 } from "slicewalk";
import { clamp, direction, distance, flat, standing, type Look } from "./geometry";
import type { Settings } from "./settings";

/** Number of places tried, from the middle outwards, and of heights tried at each. */
const SPIRAL = 49;
const MOST_HEIGHTS = 24;
/** Height above a floor from which it counts as free, because it is stored to a quantum. */
const ABOVE_FLOOR_M = 0.1;

/** Places compared for a view, and least distance between them as a share of the scan. */
const PLACES = 20;
const TRIED = 80;
/** Rays around a place: every so many degrees along, at these pitches; as far as this. */
const STEP = 10;
const RAY_PITCHES = [-82, -66, -54, -42, -30, -20, -10, 0, 10, 20, 32] as const;
const RAY_M = 150;
/** Rays for which pages are loaded first, and how far. */
const LOADED_STEP = 30;
const LOADED_M = 25;
/**
 * Pages with fewer voxels are sparse: bare rays slip between points that are drawn as a surface, so wide ones are swept as
 * well, this wide (in pixels and at most) and this far.
 */
const SPARSE = 900;
const WIDE_PIXELS = 4;
const WIDE_M = 0.8;
const SWEPT_M = 60;
/** Share of what only wide rays hit that a picture shows. */
const SWEPT_SHOWN = 0.6;
/** Pitches of views, and half the angles that a view shows. */
const PITCHES = [0, -6, -12, -18, -25, -34, -45, -58] as const;
const HALF_X = 45;
const HALF_Y = 34;
/** Share of a view that should show the scan, and how much a pitch costs per degree. */
const ENOUGH = 0.72;
const PITCH_COST = 0.005;
/** How much a place gains with all around it seen. */
const WITHIN = 0.3;
/** An eighth of the scan, between these, is as far as anything need be to be worth seeing (m). */
const LEAST_LIMIT_M = 10;
const MOST_LIMIT_M = 100;

export interface Start {
  readonly at: Vec3;
  readonly look: Look;
  /** Estimated share of the view that shows the scan, and how good it is. */
  readonly covered: number;
  readonly rating: number;
}

function* spiral(): Generator<readonly [number, number]> {
  let [x, y, dx, dy] = [0, 0, 0, -1];
  for (let n = 0; n < SPIRAL; n++) {
    yield [x, y];
    if (x === y || (x < 0 && x === -y) || (x > 0 && x === 1 - y)) [dx, dy] = [-dy, dx];
    x += dx;
    y += dy;
  }
}

/** Floors with room for the pawn at a place, from the lowest up. */
async function floors(
  archive: Archive,
  settings: Settings,
  [x, y]: readonly [number, number],
  tops: readonly number[],
  signal: AbortSignal,
): Promise<number[]> {
  const { pixelSize, sliceHeight } = archive.info;
  // As wide as the pawn: floors scanned from the air have gaps.
  const half = Math.max(pixelSize, settings.width) / 2;
  const probes = tops.flatMap((top) => [x - half, y - half, top - sliceHeight, x + half, y + half, top]);
  const found = await archive.floor(new Float64Array(probes), { load: true, signal });
  const heights = [...new Set(found)].filter(Number.isFinite).sort((a, b) => a - b);
  if (heights.length === 0) return [];
  const rooms = heights.flatMap((z) => flat(standing([x, y, z + ABOVE_FLOOR_M], settings.width, settings.height)));
  const free = await archive.overlaps(new Float64Array(rooms), { load: true, signal });
  return heights.filter((_, n) => free[n] === CLEAR);
}

/** Heights of heads, from the ground up. */
function heads({ min, max }: Bounds, sliceHeight: number): number[] {
  const storeys = clamp(Math.ceil((max[2] - min[2]) / 1.5), 1, MOST_HEIGHTS);
  return Array.from({ length: storeys }, (_, n) => min[2] + ((n + 1) * (max[2] - min[2])) / storeys + sliceHeight);
}

/** A floor with room near the middle, the lowest one there: the ground floor. */
export async function findStart(
  archive: Archive,
  settings: Settings,
  bounds: Bounds,
  signal: AbortSignal,
): Promise<Vec3 | null> {
  const { min, max } = bounds;
  const span = Math.min(max[0] - min[0], max[1] - min[1]);
  const stride = clamp(span / 9, Math.min(2 * settings.width, span / 9), 8);
  const tops = heads(bounds, archive.info.sliceHeight);
  for (const [across, along] of spiral()) {
    const x = (min[0] + max[0]) / 2 + across * stride;
    const y = (min[1] + max[1]) / 2 + along * stride;
    if (x < min[0] || x > max[0] || y < min[1] || y > max[1]) continue;
    const [z] = await floors(archive, settings, [x, y], tops, signal);
    if (z !== undefined) return [x, y, z];
  }
  return null;
}

/** The best place and direction to begin, from `first` and others all over the scan; calls `better` for each improvement. */
export async function findView(
  archive: Archive,
  settings: Settings,
  bounds: Bounds,
  first: Vec3 | null,
  signal: AbortSignal,
  better: (start: Start) => void,
): Promise<void> {
  let best: Start | null = null;
  const tops = heads(bounds, archive.info.sliceHeight);
  const { min, max } = bounds;
  const tried: Vec3[] = [];
  const apart = distance(min, max) / 40;
  const judge = async (at: Vec3): Promise<void> => {
    tried.push(at);
    const start = await viewFrom(archive, at, settings.eye, signal);
    if (best === null || start.rating > best.rating) better((best = start));
  };
  if (first !== null) await judge(first);
  for (let n = 1; n <= TRIED && tried.length < PLACES; n++) {
    if (signal.aborted) return;
    const [u, v] = [halton(n, 2), halton(n, 3)];
    // From the middle outwards: views from within show more than views from the edge.
    const inner = 0.35 + (0.6 * n) / TRIED;
    const x = (min[0] + max[0]) / 2 + (u - 0.5) * inner * (max[0] - min[0]);
    const y = (min[1] + max[1]) / 2 + (v - 0.5) * inner * (max[1] - min[1]);
    try {
      for (const z of (await floors(archive, settings, [x, y], tops, signal)).slice(0, 3)) {
        const at: Vec3 = [x, y, z];
        if (tried.every((other) => distance(other, at) > apart)) await judge(at);
      }
    } catch (error) {
      // Where the budget has no room for a place's pages, another one is looked at.
      if (signal.aborted || archive.error !== null) throw error;
    }
  }
}

/** Evenly spread numbers between 0 and 1. */
function halton(index: number, base: number): number {
  let [share, value] = [1, 0];
  for (let n = index; n > 0; n = Math.floor(n / base)) {
    share /= base;
    value += share * (n % base);
  }
  return value;
}

/** The best direction to look from a place, by rays in all directions through what is loaded. */
export async function viewFrom(archive: Archive, at: Vec3, eye: number, signal: AbortSignal): Promise<Start> {
  const { bounds } = archive.info;
  const limit = bounds === null ? LEAST_LIMIT_M : clamp(distance(bounds.min, bounds.max) / 8, LEAST_LIMIT_M, MOST_LIMIT_M);
  const from: Vec3 = [at[0], at[1], at[2] + eye];
  const row = (heading: number, pitch: number, far: number): number[] => [...from, ...direction({ heading, pitch }), far];
  const turns = (step: number): number[] => Array.from({ length: 360 / step }, (_, n) => n * step);
  const loading = turns(LOADED_STEP).flatMap((heading) => [-25, 0].flatMap((pitch) => row(heading, pitch, LOADED_M)));
  await archive.cast(new Float64Array(loading), { load: true, signal }).catch((error: unknown) => {
    if (signal.aborted) throw error; // otherwise the budget is full: judge by what there is
  });
  const headings = turns(STEP);
  const rays = headings.flatMap((heading) => RAY_PITCHES.flatMap((pitch) => row(heading, pitch, RAY_M)));
  const { distances } = await archive.castFar(new Float64Array(rays), { signal });
  const shown = distances.map((far) => (far < Infinity ? 1 : 0));
  const { voxels, pages } = archive.info;
  if (voxels.occupied < SPARSE * pages) {
    const wide = Math.min(WIDE_M, WIDE_PIXELS * archive.info.pixelSize);
    const box = flat(standing([from[0], from[1], from[2] - wide / 2], wide, wide));
    const ways = headings.flatMap((heading) => RAY_PITCHES.map((pitch) => direction({ heading, pitch })));
    const swept = await archive.sweep(new Float64Array(ways.flatMap((way) => [...box, ...way.map((v) => v * SWEPT_M)])), {
      signal,
    });
    swept.forEach((share, n) => {
      const far = distances[n] ?? NaN;
      if (!(share < 1) || far < share * SWEPT_M) return;
      distances[n] = share * SWEPT_M;
      shown[n] = Math.max(shown[n] ?? 0, SWEPT_SHOWN);
    });
  }
  // Within a place there is something to see all around; beside it, in one direction only.
  let [everywhere, around] = [0, 0];
  shown.forEach((share, n) => {
    const weight = Math.cos(((RAY_PITCHES[n % RAY_PITCHES.length] ?? 0) * Math.PI) / 180);
    everywhere += weight;
    around += weight * share;
  });
  const within = WITHIN * (around / everywhere);
  let best: Start = { at, look: { heading: 0, pitch: 0 }, covered: 0, rating: -1 };
  for (const heading of headings) {
    for (const pitch of PITCHES) {
      let [all, hits, worth] = [0, 0, 0];
      for (let turn = -HALF_X + 5; turn < HALF_X; turn += STEP) {
        const column = ((((heading + turn) / STEP) % headings.length) | 0) + headings.length;
        RAY_PITCHES.forEach((up, n) => {
          if (Math.abs(up - pitch) > HALF_Y) return;
          // Rows of rays are closer together near the horizon.
          const weight = Math.cos((up * Math.PI) / 180) * (up > -32 && up < 22 ? 1 : 1.2);
          const ray = (column % headings.length) * RAY_PITCHES.length + n;
          all += weight;
          hits += weight * (shown[ray] ?? 0);
          worth += weight * (shown[ray] ?? 0) * worthOf(distances[ray] ?? NaN, limit);
        });
      }
      const covered = hits / all;
      const rating = (worth / all) * Math.min(1, covered / ENOUGH) ** 2 + PITCH_COST * pitch + within;
      if (rating > best.rating) best = { at, look: { heading, pitch }, covered, rating };
    }
  }
  return best;
}

/** What is near fills the picture with little to see; far things tell more, up to a limit. */
function worthOf(far: number, limit: number): number {
  if (!(far >= 0.8)) return 0.05;
  return Math.min(1, 0.25 + 0.75 * (Math.log2(far / 0.8) / Math.log2(limit / 0.8)));
}
