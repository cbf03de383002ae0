// Directions, rays and numbers of the page. World coordinates are those of the scan, in metres, z up.

import type { Bounds, Vec3 } from "slicewalk";

/** Viewing direction in degrees: heading 0 is +y, clockwise; pitch is positive upwards. */
export interface Look {
  heading: number;
  pitch: number;
}

export interface Ray {
  readonly origin: Vec3;
  readonly direction: Vec3;
}

const RADIANS = Math.PI / 180;

/** Whether a value is an array of any kind, of this many numbers within ±`most`: files and programs may give anything. */
export const isNumbers = (value: unknown, count: number, most = Number.MAX_VALUE): boolean => {
  const isList = Array.isArray(value) || ArrayBuffer.isView(value);
  const all: unknown[] = isList ? Array.from(value as unknown as ArrayLike<unknown>) : [];
  return all.length === count && all.every((each) => typeof each === "number" && Math.abs(each) <= most);
};

export const clamp = (value: number, low: number, high: number): number => Math.min(high, Math.max(low, value));

export const add = (a: Vec3, b: Vec3, scale = 1): Vec3 => [a[0] + scale * b[0], a[1] + scale * b[1], a[2] + scale * b[2]];

export const subtract = (a: Vec3, b: Vec3): Vec3 => add(a, b, -1);

export const distance = (a: Vec3, b: Vec3): number => Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);

/** Wraps an angle to 0 to 360. */
export const wrap = (degrees: number): number => ((degrees % 360) + 360) % 360;

/** Wraps an index to 0 to `count - 1`. */
export const wrapInto = (index: number, count: number): number => ((index % count) + count) % count;

/** Unit vector of a viewing direction. */
export function direction({ heading, pitch }: Look): Vec3 {
  const [h, p] = [heading * RADIANS, pitch * RADIANS];
  return [Math.sin(h) * Math.cos(p), Math.cos(h) * Math.cos(p), Math.sin(p)];
}

/** Horizontal unit vectors: forward and to the right. */
export function across(heading: number): { forward: readonly [number, number]; right: readonly [number, number] } {
  const [sin, cos] = [Math.sin(heading * RADIANS), Math.cos(heading * RADIANS)];
  return { forward: [sin, cos], right: [cos, -sin] };
}

/** Box that stands at `feet`. */
export function standing(feet: Vec3, width: number, height: number): Bounds {
  const half = width / 2;
  return { min: [feet[0] - half, feet[1] - half, feet[2]], max: [feet[0] + half, feet[1] + half, feet[2] + height] };
}

export const flat = ({ min, max }: Bounds): number[] => [...min, ...max];

/** Formats metres to the millimetre, or to the centimetre for large coordinates. */
export const metres = (value: number, digits = 2): string => (Object.is(value, -0) ? 0 : value).toFixed(digits);

export function bytes(count: number): string {
  if (count < 1000) return `${count} B`;
  const units = ["kB", "MB", "GB", "TB"];
  const power = Math.min(units.length - 1, Math.floor(Math.log10(count) / 3) - 1);
  const value = count / 1000 ** (power + 1);
  return `${value < 10 ? value.toFixed(1) : Math.round(value)} ${units[power]}`;
}

export function thousands(count: number): string {
  return Math.round(count).toLocaleString("en");
}
