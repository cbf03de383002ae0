// Colours of pages as textures, in which the shader looks up the voxel behind a face.

import type { PageColours } from "slicewalk";
import { DataTexture, RGBAFormat, RGBAIntegerFormat, UnsignedByteType, UnsignedIntType, Vector4 } from "three";

/** Colours per row of their texture. */
const ROW = 256;

export interface Paint {
  /** One texel per cell: its slices with colours, and the index of its first colour. */
  readonly cells: DataTexture;
  readonly colours: DataTexture;
  readonly bytes: number;
}

function textures(edge: number, cells: Uint32Array, colours: Uint8Array): Paint {
  const rows = Math.max(1, Math.ceil(colours.length / 4 / ROW));
  const whole = new Uint8Array(4 * ROW * rows);
  whole.set(colours);
  const paint = {
    cells: new DataTexture(cells, edge, edge, RGBAIntegerFormat, UnsignedIntType),
    colours: new DataTexture(whole, ROW, rows, RGBAFormat, UnsignedByteType),
    bytes: cells.byteLength + whole.byteLength,
  };
  paint.cells.internalFormat = "RGBA32UI";
  [paint.cells, paint.colours].forEach((texture) => (texture.needsUpdate = true));
  return paint;
}

export const paintOf = ({ edge, cells, colours }: PageColours): Paint => textures(edge, cells, colours);

/** No colours. */
export const PLAIN: Paint = textures(1, new Uint32Array(4), new Uint8Array(0));

/** Mean of the colours, 0 to 1; alpha 0 without any. */
export function meanOf({ colours }: Paint): Vector4 {
  const bytes = colours.image.data as Uint8Array;
  const sum = [0, 0, 0, 0];
  for (let at = 0; at < bytes.length; at += 4) {
    if (bytes[at + 3] !== 255) continue;
    sum.forEach((_, n) => (sum[n]! += n < 3 ? (bytes[at + n] ?? 0) : 255));
  }
  const count = (sum[3] ?? 0) / 255;
  return count === 0 ? new Vector4() : new Vector4(...sum.map((value) => value / count / 255));
}

export function forget({ cells, colours }: Paint): void {
  cells.dispose();
  colours.dispose();
}
