// Measurements of the scene by exact collision queries, each with its error.
//
// Solid in an archive extends at most a pixel `t` beyond the points horizontally, and at most a quantum (slice height /
// 255) along z, and never less far. So a clear width is at least the measured one and at most `2t` more: the middle is
// reported, ± t.

import type { Archive, Vec3 } from "slicewalk";
import { add, direction, distance, type Ray } from "./geometry";

export interface Value {
  readonly metres: number;
  readonly error: number;
}

export interface Spot {
  readonly at: Vec3;
  readonly normal: Vec3;
}

export interface Surroundings {
  /** Null if open to the sky, or wider than the search range. */
  readonly headroom: Value | null;
  readonly width: Value | null;
  /** Smallest height difference to a neighbouring floor that exceeds noise. */
  readonly step: Value | null;
}

const PICK_M = 5000;
/**
 * Length of a ray for which pages are loaded at a time, beyond the distance that an overview level shows to be free.
 */
const PIECE_M = 16;
/** Distance up to which surfaces with gaps stop a ray that would otherwise get more than this many pixels farther. */
const NEAR_M = 60;
const GAP_PIXELS = 2;
const HEADROOM_M = 60;
const PLATE_M = 0.01;
const WIDTH_M = 20;
/** Heights above the floor between which widths are measured, from shins to shoulders. */
const BODY_M = [0.3, 1.4] as const;
/** Directions in half a turn. */
const DIRECTIONS = 36;
/** Floors are compared within this distance, in eight directions. */
const STEP_M = 0.35;
const STEP_PLACES = 8;
/** Height above which a step counts as a wall. */
const HIGHEST_STEP_M = 1.2;

export const pixelError = (archive: Archive): number => archive.info.pixelSize + archive.info.tolerance;

export const heightError = (archive: Archive): number => archive.info.sliceHeight / 255 + archive.info.tolerance;

/**
 * Finds the first solid along a ray two pixels wide; a bare ray slips through gaps in sparse surfaces. If a floor seen
 * from above is at or beside the hit, the spot is on the floor. Loads the pages it needs.
 */
export async function pick(archive: Archive, { origin, direction }: Ray, signal: AbortSignal): Promise<Spot | null> {
  const options = { load: true, signal };
  const { hit, normal } = await cast(archive, { origin, direction }, signal);
  const half = archive.info.pixelSize;
  const reach = Math.min(hit, NEAR_M);
  const box = [...origin.map((value) => value - half), ...origin.map((value) => value + half)];
  const sweep = new Float64Array([...box, ...direction.map((way) => way * reach)]);
  const stop = ((await archive.sweep(sweep, options))[0] ?? NaN) * reach;
  // A box touches the face earlier than the ray by this.
  const facing = Math.abs(normal[0] * direction[0] + normal[1] * direction[1] + normal[2] * direction[2]);
  const ahead = hit <= NEAR_M ? half / facing : 0;
  const slipped = stop > 0 && stop < reach - ahead - GAP_PIXELS * half;
  const far = slipped ? stop + half : hit;
  if (!Number.isFinite(far)) return null;
  const at = add(origin, direction, far);
  if (direction[2] < 0 && (slipped || normal[2] <= 0)) {
    const around = [at[0] - half, at[1] - half, at[2] - 2 * half, at[0] + half, at[1] + half, at[2] + 2 * half];
    const floor = (await archive.floor(new Float64Array(around), options))[0] ?? NaN;
    if (Math.abs(floor - at[2]) <= 2 * half) return { at: [at[0], at[1], floor], normal: [0, 0, 1] };
  }
  return { at, normal: slipped ? [-direction[0], -direction[1], 0] : normal };
}

/** Finds what a ray hits. Where an overview level shows that the ray is free, no page is loaded. */
async function cast(archive: Archive, { origin, direction }: Ray, signal: AbortSignal): Promise<{ hit: number; normal: Vec3 }> {
  let from = 0;
  while (from < PICK_M) {
    const ray = (length: number): Float64Array => new Float64Array([...add(origin, direction, from), ...direction, length]);
    const { distances, coarse } = await archive.castFar(ray(PICK_M - from), { signal });
    if (distances[0] === Infinity) break;
    const isCoarse = coarse[0] === 1;
    from += isCoarse ? (distances[0] ?? 0) : 0;
    const length = isCoarse ? Math.min(PIECE_M, PICK_M - from) : PICK_M - from;
    const { distances: hits, normals } = await archive.castHits(ray(length), { load: true, signal });
    const hit = hits[0] ?? NaN;
    if (hit !== Infinity) return { hit: from + hit, normal: [normals[0] ?? 0, normals[1] ?? 0, normals[2] ?? 0] };
    from += length;
  }
  return { hit: Infinity, normal: [0, 0, 0] };
}

/** Distance, horizontal distance and height difference of two places. */
export interface Measured {
  readonly ends: readonly [Vec3, Vec3];
  readonly straight: Value;
  readonly across: Value;
  readonly height: Value;
}

export function between(archive: Archive, a: Vec3, b: Vec3): Measured {
  const [across, height] = [Math.hypot(a[0] - b[0], a[1] - b[1]), b[2] - a[2]];
  const [t, q] = [pixelError(archive), heightError(archive)];
  return {
    ends: [a, b],
    straight: { metres: distance(a, b), error: Math.hypot(2 * t, 2 * q) },
    across: { metres: across, error: 2 * t },
    height: { metres: height, error: 2 * q },
  };
}

/** Headroom, clear width and step at a place. Loads the pages it needs. */
export async function surroundings(archive: Archive, at: Vec3, signal: AbortSignal): Promise<Surroundings> {
  const [t, q] = [pixelError(archive), heightError(archive)];
  const above = Math.max(0.05, 2 * q);
  const options = { load: true, signal };
  const post = archive.info.pixelSize;
  // A plate of two pixels is swept upwards: unlike a ray it does not slip through sparse lintels and ceilings.
  const [low, high] = [at[2] + above, at[2] + above + PLATE_M];
  const plate = [at[0] - post, at[1] - post, low, at[0] + post, at[1] + post, high, 0, 0, HEADROOM_M];
  const share = (await archive.sweep(new Float64Array(plate), options))[0] ?? NaN;
  const room = share < 1 ? share * HEADROOM_M + PLATE_M : Infinity;
  // A thin post is swept away from the place in every direction: unlike a ray it does not slip through sparse walls.
  const turns = Array.from({ length: 2 * DIRECTIONS }, (_, n) => (n * 180) / DIRECTIONS);
  const sweeps = turns.flatMap((heading) => {
    const way = direction({ heading, pitch: 0 });
    const low = [at[0] - post, at[1] - post, at[2] + BODY_M[0]];
    return [...low, at[0] + post, at[1] + post, at[2] + BODY_M[1], WIDTH_M * way[0], WIDTH_M * way[1], 0];
  });
  const shares = await archive.sweep(new Float64Array(sweeps), options);
  const free = [...shares].map((share) => (share < 1 ? share * WIDTH_M : Infinity) + post);
  const widths = free.slice(0, DIRECTIONS).map((one, n) => one + (free[n + DIRECTIONS] ?? NaN));
  const width = Math.min(...widths);

  const around = Array.from({ length: STEP_PLACES }, (_, n) => direction({ heading: (n * 360) / STEP_PLACES, pitch: 0 }));
  const places = [[0, 0, 0] as Vec3, ...around];
  const half = archive.info.pixelSize / 4;
  const boxes = places.flatMap((side) => {
    const [x, y] = [at[0] + side[0] * STEP_M, at[1] + side[1] * STEP_M];
    return [x - half, y - half, at[2] - HIGHEST_STEP_M, x + half, y + half, at[2] + HIGHEST_STEP_M];
  });
  const floors = await archive.floor(new Float64Array(boxes), options);
  const here = floors[0] ?? NaN;
  const noise = Math.max(0.03, 4 * q);
  const steps = [...floors.slice(1)].map((z) => Math.abs(z - here)).filter((rise) => rise > noise && rise <= HIGHEST_STEP_M);
  return {
    headroom: Number.isFinite(room) ? { metres: room + above + q, error: q } : null,
    width: Number.isFinite(width) ? { metres: width + t, error: t } : null,
    step: steps.length > 0 ? { metres: Math.min(...steps), error: q } : null,
  };
}
