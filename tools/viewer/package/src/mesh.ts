/**
 * Pages as meshes for graphics engines: plain arrays for the `BufferGeometry` of three.js, the `VertexData` of Babylon.js
 * or the `Mesh` of PlayCanvas. Nothing else of the package is loaded.
 */

import type { PageColours, PageGeometry, Vec3 } from "./types.js";

/** Turns a place or direction of the scan (z up) into one of a scene with y up: x, z, -y. */
export function toYUp([x, y, z]: Vec3): [number, number, number] {
  return [x, z, 0 - y];
}

/** Turns a place or direction of a scene with y up into one of the scan. */
export function fromYUp([x, y, z]: Vec3): [number, number, number] {
  return [x, 0 - z, y];
}

/** Red, green and blue, 0 to 1 (sRGB). */
export type Rgb = readonly [number, number, number];

export interface MeshOptions {
  /**
   * Place of the scan at the scene's zero. Choose one near the scan, and the same for all pages: coordinates of scans are
   * too large for the single precision of graphics cards.
   */
  readonly origin: Vec3;
  /** The axis that points up in the scene; `y` by default. */
  readonly up?: "y" | "z";
  /**
   * Colours of the page, from `onColours`. Each vertex takes that of the voxel behind its face, or of one beside it. Faces
   * blend the colours of their corners: a shader that looks up the textures of {@link PageColours} shows more.
   */
  readonly scan?: {
    readonly colours: PageColours;
    readonly info: { readonly pixelSize: number; readonly sliceHeight: number };
  };
  /** Colours of floor and of obstacles where the scan gives none. */
  readonly floor?: Rgb;
  readonly obstacle?: Rgb;
  /** Returns colours in linear space, as three.js expects them, instead of sRGB. False by default. */
  readonly linear?: boolean;
}

export interface PageAttributes {
  /** Three per vertex, from the scene's zero (m). */
  readonly positions: Float32Array;
  /** Three per vertex, of length 1. */
  readonly normals: Float32Array;
  /** Four per vertex: red, green, blue, 1. */
  readonly colours: Float32Array;
  /** Three per triangle, counterclockwise seen from outside. Pages share this memory: do not write to it. */
  readonly indices: Uint32Array;
}

const FLOOR: Rgb = [0.75, 0.78, 0.8];
const OBSTACLE: Rgb = [0.72, 0.63, 0.54];
/** Pixels along the edge of a page, and its slices. */
const PAGE_PIXELS = 64;
const PAGE_SLICES = 64;
/** Slices above and below in which a colour is sought, because drawn heights are rounded; more where cells are larger. */
const REACH = 3;
/** Cells around that of a vertex in which a colour is sought. */
const BESIDE = 2;

/** Returns the attributes of a page's mesh. */
export function pageAttributes(page: PageGeometry, options: MeshOptions): PageAttributes {
  const { origin, up = "y", floor = FLOOR, obstacle = OBSTACLE, scan, linear = false } = options;
  const count = page.positions.length / 3;
  const positions = new Float32Array(3 * count);
  const normals = new Float32Array(3 * count);
  const colours = new Float32Array(4 * count);
  // Where x, y and z of the scan go, and the sign of its y.
  const [toY, toZ, sign] = up === "y" ? [2, 1, -1] : [1, 2, 1];
  const [scaleX, scaleY, scaleZ] = page.scale;
  const [x0, y0, z0] = page.origin.map((v, axis) => v - (origin[axis] ?? 0)) as [number, number, number];
  const light = linear ? LINEAR : PLAIN;
  const behind = scan && colourBehind(page, scan.colours, scan.info);
  for (let vertex = 0; vertex < count; vertex++) {
    const [at, four] = [3 * vertex, 4 * vertex];
    const [x, y, z] = [number(page.positions, at), number(page.positions, at + 1), number(page.positions, at + 2)];
    positions[at] = x0 + scaleX * x;
    positions[at + toY] = sign * (y0 + scaleY * y);
    positions[at + toZ] = z0 + scaleZ * z;
    const [nx, ny, nz] = [number(page.normals, four), number(page.normals, four + 1), number(page.normals, four + 2)];
    const length = Math.sqrt(nx * nx + ny * ny + nz * nz) || 1;
    normals[at] = nx / length;
    normals[at + toY] = (sign * ny) / length;
    normals[at + toZ] = nz / length;
    const found = behind ? behind(vertex) : -1;
    const plain = number(page.attributes, four + 1) ? obstacle : floor;
    for (let channel = 0; channel < 3; channel++) {
      const byte =
        scan && found >= 0 ? number(scan.colours.colours, found + channel) : Math.round(255 * number(plain, channel));
      colours[four + channel] = number(light, byte);
    }
    colours[four + 3] = 1;
  }
  return { positions, normals, colours, indices: page.indices };
}

/** Values of a byte of a colour, 0 to 1. */
const PLAIN = Float32Array.from({ length: 256 }, (_, byte) => byte / 255);
const LINEAR = PLAIN.map((value) => (value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4));

function number(numbers: ArrayLike<number>, at: number): number {
  return numbers[at] ?? 0;
}

/** Returns a function from a vertex to the first byte of the colour of the voxel behind its face; -1 if it has none. */
function colourBehind(
  { key, scale, positions, normals, attributes }: PageGeometry,
  { edge, cells }: PageColours,
  info: { readonly pixelSize: number; readonly sliceHeight: number },
): (vertex: number) => number {
  const coarser = 4 ** key.level;
  // Cells and slices of the colours per unit of the positions.
  const wide = (scale[0] / (info.pixelSize * PAGE_PIXELS * coarser)) * edge;
  const high = scale[2] / (info.sliceHeight * coarser);
  const block = Math.max(1, Math.round(wide));
  const reach = REACH * Math.max(1, Math.round((PAGE_PIXELS * wide) / edge));

  function ofVoxel(x: number, y: number, slice: number): number {
    const cell = 4 * (edge * y + x);
    const [low, upper] = [number(cells, cell), number(cells, cell + 1)];
    if (low === 0 && upper === 0) {
      return -1;
    }
    for (let n = 0; n <= 2 * reach; n++) {
      const k = slice + (n % 2 === 1 ? -(n + 1) / 2 : n / 2);
      const [word, bit] = [k < 32 ? low : upper, k & 31];
      if (k >= 0 && k < PAGE_SLICES && (word >>> bit) & 1) {
        const below = ones(word & ((1 << bit) - 1)) + (k < 32 ? 0 : ones(low));
        return 4 * (number(cells, cell + 2) + below);
      }
    }
    return -1;
  }

  return (vertex) => {
    // A corner lies between voxels: half a cell into the quad, towards its opposite corner, or behind it.
    const [at, across, four] = [3 * vertex, 3 * (vertex ^ 2), 4 * vertex];
    const cellAlong = (axis: 0 | 1): number => {
      const here = number(positions, at + axis);
      const inward = Math.sign(number(positions, across + axis) - here) || -Math.sign(number(normals, four + axis));
      return Math.floor((here + 0.5 * inward) * wide - 0.5 * (block - 1));
    };
    const [x, y] = [cellAlong(0), cellAlong(1)];
    const z = number(positions, at + 2);
    const face = number(attributes, four);
    const inward = face === 0 ? -0.02 : face === 1 ? 0.02 : 0.5 * Math.sign(number(positions, across + 2) - z);
    const slice = Math.floor(z * high + inward);
    // Cells of colours may be finer than those of the mesh, and a mesh closes holes: the nearest cell with a colour counts.
    for (let ring = 0; ring <= BESIDE; ring++) {
      const edges = block + 2 * ring - 1;
      for (let dy = -ring; dy < block + ring; dy++) {
        const isEnd = dy === -ring || dy === block + ring - 1;
        for (let dx = -ring; dx < block + ring; dx += isEnd || ring === 0 ? 1 : edges) {
          const found = ofVoxel(Math.min(Math.max(x + dx, 0), edge - 1), Math.min(Math.max(y + dy, 0), edge - 1), slice);
          if (found >= 0) {
            return found;
          }
        }
      }
    }
    return -1;
  };
}

/** Number of ones in a word. */
function ones(word: number): number {
  let rest = word - ((word >>> 1) & 0x55555555);
  rest = (rest & 0x33333333) + ((rest >>> 2) & 0x33333333);
  return Math.imul((rest + (rest >>> 4)) & 0x0f0f0f0f, 0x01010101) >>> 24;
}
