// Views from outside that show all of a scan and as much of it as possible, found from the boxes of its pages.

import type { Bounds, Vec3 } from "slicewalk";
import { across, add, clamp, direction, type Look } from "../geometry";

export interface Frame {
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
const MOST_BOXES = 500;
/** Cells of the picture in which boxes are counted. */
const [WIDE, HIGH] = [48, 27];
/** Part of the picture that the scan may fill, beside the bars above and below. */
const MARGIN_X = 0.95;
const MARGIN_Y = 0.86;
/** The scan is this part of half the height above the middle, because a card lies below. */
const LIFT = -0.08;
/** Pictures with less of the scan are taken from nearer, down to this part of the distance. */
const ENOUGH = 0.34;
const NEARER = 0.8;

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

/** Some of the boxes, cut off at the bounds of the content. */
function within(boxes: Float64Array, { min, max }: Bounds): number[][] {
  const count = boxes.length / 6;
  const kept: number[][] = [];
  const step = Math.max(1, count / MOST_BOXES);
  for (let at = 0; at < count; at += step) {
    const row = [...boxes.subarray(6 * Math.floor(at), 6 * Math.floor(at) + 6)];
    const cut = row.map((value, n) => clamp(value, min[n % 3] ?? value, max[n % 3] ?? value));
    if ([0, 1, 2].every((axis) => (cut[axis] ?? 0) < (cut[axis + 3] ?? 0))) kept.push(cut);
  }
  return kept;
}

/** Eight corners of a box. */
const corners = (box: readonly number[]): Vec3[] =>
  Array.from({ length: 8 }, (_, n) => [box[n & 1 ? 3 : 0] ?? 0, box[n & 2 ? 4 : 1] ?? 0, box[n & 4 ? 5 : 2] ?? 0]);

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
  let best: (Frame & { rating: number }) | null = null;
  for (const [pitch, pleasant] of PITCHES) {
    for (let n = 0; n < HEADINGS; n++) {
      const look = { heading: (n * 360) / HEADINGS + 7.5, pitch };
      const basis = axes(look);
      const seen = points.map((box) => box.map((at) => basis.map((axis) => dot(axis, add(at, middle, -1)))));
      const all = seen.flat();
      // Moves the target until the outline is in the middle, and away until it fits.
      let [distance, right, up] = [0.5, 0, 0];
      for (let turn = 0; turn < 3; turn++) {
        for (const [x = 0, y = 0, z = 0] of turn === 0 ? all : []) {
          distance = Math.max(distance, Math.abs(x) / (tanX * MARGIN_X) - z, Math.abs(y) / (tanY * MARGIN_Y) - z);
        }
        let [x0, x1, y0, y1] = [Infinity, -Infinity, Infinity, -Infinity];
        for (const [x = 0, y = 0, z = 0] of all) {
          const far = Math.max(z + distance, 0.05 * distance);
          [x0, x1] = [Math.min(x0, x / far), Math.max(x1, x / far)];
          [y0, y1] = [Math.min(y0, y / far), Math.max(y1, y / far)];
        }
        const [shiftX, shiftY] = [((x0 + x1) / 2) * distance, ((y0 + y1) / 2 + LIFT * tanY) * distance];
        all.forEach((point) => {
          point[0] = (point[0] ?? 0) - shiftX;
          point[1] = (point[1] ?? 0) - shiftY;
        });
        [right, up] = [right + shiftX, up + shiftY];
        distance *= Math.max((x1 - x0) / 2 / (tanX * MARGIN_X), (y1 - y0) / 2 / (tanY * MARGIN_Y));
      }
      const target = add(add(middle, basis[0], right), basis[1], up);
      let covered = cover(seen, distance, tanX, tanY);
      if (covered < ENOUGH) {
        distance *= Math.max(NEARER, Math.sqrt(covered / ENOUGH));
        covered = cover(seen, distance, tanX, tanY);
      }
      const rating = covered * pleasant;
      if (best === null || rating > best.rating) best = { target, distance, look, covered, rating };
    }
  }
  return best ?? { target: middle, distance: 20, look: { heading: 30, pitch: -35 }, covered: 0 };
}

/** Share of the cells of a picture that boxes, given by their corners in the camera's axes, touch. */
function cover(boxes: readonly (readonly number[][])[], distance: number, tanX: number, tanY: number): number {
  const cells = new Uint8Array(WIDE * HIGH);
  for (const box of boxes) {
    let [left, right, low, high] = [Infinity, -Infinity, Infinity, -Infinity];
    for (const [x = 0, y = 0, z = 0] of box) {
      const far = Math.max(z + distance, 0.05 * distance);
      const [sx, sy] = [((x / far / tanX + 1) / 2) * WIDE, ((y / far / tanY + 1) / 2) * HIGH];
      [left, right, low, high] = [Math.min(left, sx), Math.max(right, sx), Math.min(low, sy), Math.max(high, sy)];
    }
    const [x0, x1] = [clamp(Math.round(left), 0, WIDE), clamp(Math.round(right), 0, WIDE)];
    const [y0, y1] = [clamp(Math.round(low), 0, HIGH), clamp(Math.round(high), 0, HIGH)];
    for (let y = y0; y < y1; y++) cells.fill(1, y * WIDE + x0, y * WIDE + x1);
  }
  return cells.reduce((sum, cell) => sum + cell, 0) / cells.length;
}
