// Why a pawn has no way to a place: where the way of a pawn that gets there stops for it, and what would pass. The pawn is changed in
// one respect at a time, as little as possible, as `slicetool route` does.

import type { Archive, Vec3 } from "slicewalk";
import { walkerSettings, type Settings } from "./settings";

export type Reason = "width" | "headroom" | "step";

export interface Obstacle {
  /** The last place of the way that the pawn reaches. */
  readonly at: Vec3;
  readonly reason: Reason;
  /** Width, height or highest step of a pawn that passes (m). */
  readonly needs: number;
  /** The way of that pawn. */
  readonly way: readonly Vec3[];
}

/** Least width and height that are tried, least height above the climb height, and highest step (m). */
const NARROWEST_M = 0.1;
const LOWEST_M = 0.3;
const ABOVE_CLIMB_M = 0.05;
const HIGHEST_STEP_M = 3;
/** Precision of what is needed, and of the place (m). */
const PRECISION_M = 0.05;
/**
 * Time after which the search is given up (ms): it ends sooner when the pawn is sent elsewhere. Some sixteen routes are looked for,
 * each of which waits for some frames, and these are slow where no graphics card draws them.
 */
export const PATIENCE_MS = 60_000;

interface Change {
  readonly reason: Reason;
  readonly own: number;
  /** The value furthest from it that is tried. */
  readonly furthest: number;
  apply(value: number): Settings;
}

function changes(settings: Settings): readonly Change[] {
  const { width, height, climb } = settings;
  const lowest = Math.max(LOWEST_M, climb + ABOVE_CLIMB_M);
  const highest = Math.min(HIGHEST_STEP_M, height - ABOVE_CLIMB_M);
  return [
    { reason: "width", own: width, furthest: Math.min(NARROWEST_M, width), apply: (value) => ({ ...settings, width: value }) },
    { reason: "headroom", own: height, furthest: lowest, apply: (value) => ({ ...settings, height: value }) },
    { reason: "step", own: climb, furthest: highest, apply: (value) => ({ ...settings, climb: value }) },
  ];
}

/** Places along a way, at most `step` apart. */
function placesOf(way: readonly Vec3[], step: number): readonly Vec3[] {
  return way.flatMap((to, n) => {
    const from = way[n - 1] ?? to;
    const steps = Math.max(1, Math.ceil(Math.hypot(to[0] - from[0], to[1] - from[1]) / step));
    const between = (k: number): Vec3 =>
      [0, 1, 2].map((axis) => (from[axis] ?? 0) + (((to[axis] ?? 0) - (from[axis] ?? 0)) * k) / steps) as unknown as Vec3;
    return n === 0 ? [to] : Array.from({ length: steps }, (_, k) => between(k + 1));
  });
}

/** Finds why a pawn with these settings has no way; null if no single change helps, or it takes too long. */
export async function findObstacle(
  archive: Archive,
  settings: Settings,
  from: Vec3,
  to: Vec3,
  signal: AbortSignal,
): Promise<Obstacle | null> {
  const until = AbortSignal.any([signal, AbortSignal.timeout(PATIENCE_MS)]);
  const route = async (changed: Settings, end: Vec3): Promise<readonly Vec3[] | null> => {
    const walker = await archive.walker({ ...walkerSettings(changed), at: from });
    try {
      const found = await walker.route(end, { signal: until });
      return typeof found === "string" ? null : found.points;
    } finally {
      walker.close();
    }
  };
  try {
    let best: Omit<Obstacle, "at"> | null = null;
    let least = Infinity;
    for (const { reason, own, furthest, apply } of changes(settings)) {
      const shareOf = (value: number): number => Math.abs(value - own) / Math.max(own, PRECISION_M);
      let [blocked, passes, way] = [own, furthest, await route(apply(furthest), to)];
      if (way === null) continue;
      while (Math.abs(passes - blocked) > PRECISION_M && shareOf(blocked) < least) {
        const middle = (passes + blocked) / 2;
        const found = await route(apply(middle), to);
        if (found === null) blocked = middle;
        else [passes, way] = [middle, found];
      }
      if (shareOf(passes) >= least) continue;
      least = shareOf(passes);
      best = { reason, needs: passes, way };
    }
    if (best === null) return null;
    const places = placesOf(best.way, PRECISION_M);
    let [reached, missed] = [0, places.length - 1];
    while (missed - reached > 1) {
      const middle = (reached + missed) >> 1;
      if ((await route(settings, places[middle] ?? to)) === null) missed = middle;
      else reached = middle;
    }
    return { ...best, at: places[reached] ?? from };
  } catch {
    return null; // ended, or a failed archive that is reported elsewhere
  }
}
