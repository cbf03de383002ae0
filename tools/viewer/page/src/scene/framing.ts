// Views from outside that show all of a scan and as much of it as possible, found from the boxes of its pages.

import type { Bounds, Vec3 } from "slicewalk";
import { across, add, clamp, direction, type Look } from "../geometry";

export interface Frame {
  /** The place of the scan that is worth approaching: around it, most of the picture shows the scan. */
  readonly focus: Vec3;
  readonly target: Vec3;
  readonly distance: number;
  readonly look: Look;
  /** Estimated share of the picture that shows the scan. */
  readonly covered: number;
}

/** Fraction of pages beyond each end of an axis that count as strays. */
const STRAY = 0.015;
const HEADINGS = 24;
/** Angles from above, and how pleasant each is. */
const PITCHES = [
  [-22, 0.95],
  [-30, 1],
  [-38, 1],
  [-48, 0.92],
  [-60, 0.8],
] as const;
/** Boxes are joined to at most this many along x and y. */
const MOST_ALONG = 20;
/** Cells of the picture in which boxes are counted. */
const [WIDE, HIGH] = [48, 27];
/** Part of the picture that the scan may fill from its middle to the sides, to the bar above, and to the card below. */
const SIDE = 0.95;
const ABOVE = 0.86;
const BELOW = 0.74;
/** Least distance of the target (m). */
const LEAST_M = 0.1;
/** Share of the distance at which places to approach are compared. */
const APPROACHED = 0.5;
/** How much more must be seen elsewhere than around the middle. */
const MUCH_MORE = 1.25;
/** Least distance of what is nearest, as a share of the distance of the target. */
const CLEAR = 0.05;

/** Bounds of the scan without stray pages; null without any page. */
export function contentBounds(boxes: Float64Array, whole: Bounds | null): Bounds | null {
  const count = boxes.length / 6;
  if (count === 0) return whole;
  const ends = [0, 1, 2].map((axis) => {
    const low = Float64Array.from({ length: count }, (_, n) => boxes[6 * n + axis] ?? 0).sort();
    const high = Float64Array.from({ length: count }, (_, n) => boxes[6 * n + 3 + axis] ?? 0).sort();
    const strays = Math.floor(count * STRAY);
    const [min, max] = [low[strays] ?? 0, high[count - 1 - strays] ?? 0];
    return [Math.max(min, whole?.min[axis] ?? min), Math.min(max, whole?.max[axis] ?? max)] as const;
  });
  const corner = (end: 0 | 1): Vec3 => [ends[0]?.[end] ?? 0, ends[1]?.[end] ?? 0, ends[2]?.[end] ?? 0];
  return { min: corner(0), max: corner(1) };
}

/** The boxes, cut off at the bounds of the content; those of a part of the plan are joined to one. */
function within(boxes: Float64Array, { min, max }: Bounds): number[][] {
  const joined = new Map<number, number[]>();
  for (let at = 0; at < boxes.length; at += 6) {
    const box = [...boxes.subarray(at, at + 6)].map((value, n) => clamp(value, min[n % 3] ?? value, max[n % 3] ?? value));
    if ([0, 1, 2].some((axis) => (box[axis] ?? 0) >= (box[axis + 3] ?? 0))) continue;
    const part = ([0, 1] as const).map((axis) => {
      const share = ((box[axis] ?? 0) - min[axis]) / (max[axis] - min[axis]);
      return Math.min(MOST_ALONG - 1, Math.floor(share * MOST_ALONG));
    });
    const name = (part[0] ?? 0) + MOST_ALONG * (part[1] ?? 0);
    const other = joined.get(name) ?? box;
    joined.set(
      name,
      box.map((value, n) => (n < 3 ? Math.min(value, other[n] ?? value) : Math.max(value, other[n] ?? value))),
    );
  }
  return [...joined.values()];
}

/** Eight corners of a box. */
const corners = (box: readonly number[]): Vec3[] =>
  Array.from({ length: 8 }, (_, n) => [box[n & 1 ? 3 : 0] ?? 0, box[n & 2 ? 4 : 1] ?? 0, box[n & 4 ? 5 : 2] ?? 0]);

const middleOf = (box: readonly Vec3[]): Vec3 =>
  [0, 1, 2].map((axis) => box.reduce((sum, at) => sum + (at[axis] ?? 0), 0) / box.length) as unknown as Vec3;

/** Right, up and forward of a view. */
function axes(look: Look): readonly [Vec3, Vec3, Vec3] {
  const forward = direction(look);
  const [x, y] = across(look.heading).right;
  const up: Vec3 = [y * forward[2], -x * forward[2], x * forward[1] - y * forward[0]];
  return [[x, y, 0], up, forward];
}

const dot = (a: Vec3, b: Vec3): number => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

/** The best frame of a scan for a picture with these half angles (tangents). */
export function frame(boxes: Float64Array, bounds: Bounds, tanX: number, tanY: number): Frame {
  const kept = within(boxes, bounds);
  const middle: Vec3 = [0, 1, 2].map((axis) => ((bounds.min[axis] ?? 0) + (bounds.max[axis] ?? 0)) / 2) as unknown as Vec3;
  const hull = corners([...bounds.min, ...bounds.max]);
  const points = kept.length === 0 ? [hull] : kept.map(corners);
  let best: (Omit<Frame, "focus"> & { rating: number }) | null = null;
  for (const [pitch, pleasant] of PITCHES) {
    for (let n = 0; n < HEADINGS; n++) {
      const look = { heading: (n * 360) / HEADINGS + 7.5, pitch };
      const basis = axes(look);
      const seen = points.map((box) => box.map((at) => basis.map((axis) => dot(axis, add(at, middle, -1)))));
      const all = seen.flat();
      let distance = Math.max(LEAST_M, ...all.map(([, , z = 0]) => -z / (1 - CLEAR)));
      const across = fit(
        all.map(([x = 0, , z = 0]) => [x, z]),
        tanX * SIDE,
        tanX * SIDE,
      );
      const along = fit(
        all.map(([, y = 0, z = 0]) => [y, z]),
        tanY * BELOW,
        tanY * ABOVE,
      );
      distance = Math.max(distance, across.distance, along.distance);
      const [right, up] = [across.middle(distance), along.middle(distance)] as const;
      all.forEach((point) => {
        point[0] = (point[0] ?? 0) - right;
        point[1] = (point[1] ?? 0) - up;
      });
      const target = add(add(middle, basis[0], right), basis[1], up);
      const covered = cover(seen, distance, tanX, tanY);
      const rating = covered * pleasant;
      if (best === null || rating > best.rating) best = { target, distance, look, covered, rating };
    }
  }
  if (best === null) return { focus: middle, target: middle, distance: 20, look: { heading: 30, pitch: -35 }, covered: 0 };
  return { ...best, focus: focusOf(middle, points, best, tanX, tanY) };
}

/** The best place to approach: the middle of the scan, unless around the middle of some box much more is seen. */
function focusOf(
  middle: Vec3,
  boxes: readonly (readonly Vec3[])[],
  { target, distance, look }: Omit<Frame, "focus">,
  tanX: number,
  tanY: number,
): Vec3 {
  const basis = axes(look);
  const seen = boxes.map((box) => box.map((at) => basis.map((axis) => dot(axis, add(at, target, -1)))));
  const coveredAt = (focus: Vec3): number => {
    const away = basis.map((axis) => (1 - APPROACHED) * dot(axis, add(focus, target, -1)));
    const nearer = seen.map((box) => box.map((at) => at.map((value, axis) => value - (away[axis] ?? 0))));
    return cover(nearer, APPROACHED * distance, tanX, tanY);
  };
  let best = { focus: middle, covered: MUCH_MORE * coveredAt(middle) };
  for (const focus of boxes.map(middleOf)) {
    const covered = coveredAt(focus);
    if (covered > best.covered) best = { focus, covered };
  }
  return best.focus;
}

/**
 * Least distance from which points (offset, depth) lie within `low` and `high` (tangents) beside the axis, and the offset of
 * the axis that has as much room on both sides from a distance: a point's offset is at most `high` times its distance, so
 * both are linear.
 */
function fit(
  points: readonly (readonly [number, number])[],
  low: number,
  high: number,
): { distance: number; middle: (distance: number) => number } {
  const upper = points.reduce((most, [at, depth]) => Math.max(most, at - high * depth), -Infinity);
  const lower = points.reduce((most, [at, depth]) => Math.max(most, -at - low * depth), -Infinity);
  return {
    distance: (upper + lower) / (low + high),
    middle: (distance) => (upper - high * distance + low * distance - lower) / 2,
  };
}

/** Share of the cells of a picture that boxes, given by their corners in the camera's axes, touch. */
function cover(boxes: readonly (readonly number[][])[], distance: number, tanX: number, tanY: number): number {
  const cells = new Uint8Array(WIDE * HIGH);
  for (const box of boxes) {
    let [left, right, low, high] = [Infinity, -Infinity, Infinity, -Infinity];
    for (const [x = 0, y = 0, z = 0] of box) {
      const far = Math.max(z + distance, CLEAR * distance);
      const [sx, sy] = [((x / far / tanX + 1) / 2) * WIDE, ((y / far / tanY + 1) / 2) * HIGH];
      [left, right, low, high] = [Math.min(left, sx), Math.max(right, sx), Math.min(low, sy), Math.max(high, sy)];
    }
    const [x0, x1] = [clamp(Math.round(left), 0, WIDE), clamp(Math.round(right), 0, WIDE)];
    const [y0, y1] = [clamp(Math.round(low), 0, HIGH), clamp(Math.round(high), 0, HIGH)];
    for (let y = y0; y < y1; y++) cells.fill(1, y * WIDE + x0, y * WIDE + x1);
  }
  return cells.reduce((sum, cell) => sum + cell, 0) / cells.length;
}
