// The drawing of a storey: solid that is cut, what lies below the cut, and floor, pixel by pixel.

import { SlicewalkError, type Archive } from "slicewalk";

/** Height of the cut above the feet: above parapets, below lintels. */
export const CUT_ABOVE_M = 1.2;
/** What is drawn reaches down to this below the feet: to the next landing, not to the next storey. */
const BELOW_M = 2;
/** Solid is cut within this distance of the cut, so that sparse walls have no gaps. */
const BAND_M = 0.1;
/** Cells along the edge of a part that is loaded and drawn at a time; of the smallest one, where memory is short. */
const [PART, SMALL_PART] = [512, 32];
/** The engine's cells begin this far (pixels) beside the archive's, so that rounding errors move none of them. */
const ASIDE = 5e-4;

export const NOTHING = 0;
export const FLOOR = 1;
/** Obstacles below the cut. */
export const BELOW = 2;
export const CUT = 3;
export const UNKNOWN = 4;

/** Minimum and maximum of x and y (m). */
export type Area = readonly [x0: number, y0: number, x1: number, y1: number];

export interface Drawing {
  /** Place of the lower left corner, edge of a cell (m), and number of cells. */
  readonly min: readonly [number, number];
  readonly cell: number;
  readonly width: number;
  readonly height: number;
  /** Height of the cut. */
  readonly z: number;
  /** Row by row from the greatest y down. */
  readonly cells: Uint8Array;
}

export interface Wanted {
  readonly area: Area;
  /** Height of the feet. */
  readonly floor: number;
  /** Most cells along an edge. */
  readonly cells: number;
  /** Loads what is not in memory. */
  readonly load: boolean;
}

/** Draws an area of the storey on which feet stand at this height. */
export async function draw(
  archive: Archive,
  { area, floor, cells: most, load }: Wanted,
  signal: AbortSignal,
): Promise<Drawing> {
  const pixel = archive.info.pixelSize;
  // The pixels of the archive's grid that the area meets, both ends included; a quotient rounds otherwise than the grid.
  const ends = area.map((at) => Math.floor(at * (1 / pixel))) as [number, number, number, number];
  const [across, along] = [ends[2] - ends[0] + 1, ends[3] - ends[1] + 1];
  const coarse = Math.max(1, Math.max(across, along) / most);
  const cell = coarse * pixel;
  const min = [ends[0] * pixel, ends[1] * pixel] as const;
  const count = (pixels: number): number => Math.min(most, Math.ceil(pixels / coarse));
  const [width, height] = [count(across), count(along)];
  const z = floor + CUT_ABOVE_M;
  const cells = new Uint8Array(width * height);
  /** Draws a part from its lower left cell on. */
  const part = async (column: number, row: number, size: number): Promise<void> => {
    if (column >= width || row >= height) return;
    if (signal.aborted) throw signal.reason;
    const [wide, high] = [Math.min(size, width - column), Math.min(size, height - row)];
    const low = [min[0] + column * cell, min[1] + row * cell] as const;
    const top = [low[0] + wide * cell, low[1] + high * cell] as const;
    if (load) {
      const box = { min: [...low, floor - BELOW_M], max: [...top, z + BAND_M] } as const;
      // Cells whose pages are damaged, or do not fit into memory in the smallest part, stay unknown.
      const reason: unknown = await archive.load(box, { signal }).catch((error: unknown) => error);
      if (reason instanceof SlicewalkError && reason.kind === "out-of-memory" && size > SMALL_PART) {
        const half = size / 2;
        for (const n of [0, 1, 2, 3]) await part(column + half * (n % 2), row + half * (n >> 1), half);
        return;
      }
    }
    const corner = low.map((value) => value - ASIDE * pixel) as [number, number];
    const end = [corner[0] + wide * cell, corner[1] + high * cell] as const;
    const map = async (heights: readonly [number, number]): Promise<(x: number, y: number) => number> => {
      const found = await archive.map({ min: corner, max: end }, heights, Math.max(wide, high));
      return (x, y) => found.cells[(found.height - 1 - y) * found.width + x] ?? 0;
    };
    const [cut, below] = [await map([z - BAND_M, z + BAND_M]), await map([floor - BELOW_M, z - BAND_M])];
    for (let y = 0; y < high; y++) {
      for (let x = 0; x < wide; x++) {
        const kind = kindOf(cut(x, y), below(x, y));
        cells[(height - 1 - row - y) * width + column + x] = kind;
      }
    }
  };
  for (let row = 0; row < height; row += PART) {
    for (let column = 0; column < width; column += PART) await part(column, row, PART);
  }
  return { min, cell, width, height, z, cells };
}

/** Cells of the engine's map: 0 nothing, 1 floor, 2 obstacle, 3 not loaded. */
function kindOf(cut: number, below: number): number {
  if (cut === 3) return UNKNOWN;
  if (cut > 0) return CUT;
  return below === 3 ? UNKNOWN : below === 2 ? BELOW : below === 1 ? FLOOR : NOTHING;
}
