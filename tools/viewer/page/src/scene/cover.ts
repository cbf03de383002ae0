// Marks the pages that are drawn in full, one texel per page around the camera; the overview level is cut out there.

import type { PageGeometry, Vec3 } from "slicewalk";
import { Data3DTexture, NearestFilter, RedFormat, UnsignedByteType, Vector3, type IUniform } from "three";
import { wrapInto } from "../geometry";

/** Pages along x, y and z, powers of two: at least twice as many as are drawn in full on either side of the camera. */
const SIZE = [128, 128, 16] as const;
/** Pixels along an edge of a page, and slices of its height. */
const PAGE_PIXELS = 64;
const PAGE_SLICES = 64;
const COVERED = 255;

/** The texture repeats every `SIZE` pages; the shader reads it only near the camera. */
export class Cover {
  readonly uniforms: {
    cover: IUniform<Data3DTexture>;
    /** Size of a page (m). */
    page: IUniform<Vector3>;
    /** From the lowest corner of the origin's page to the scene's origin (m). */
    coverRest: IUniform<Vector3>;
    /** That page modulo the texture, and relative to the camera's. */
    coverWrap: IUniform<Vector3>;
    coverDelta: IUniform<Vector3>;
  };
  readonly #size: Vec3;

  constructor(pixelSize: number, sliceHeight: number) {
    this.#size = [PAGE_PIXELS * pixelSize, PAGE_PIXELS * pixelSize, PAGE_SLICES * sliceHeight];
    const texture = new Data3DTexture(new Uint8Array(SIZE[0] * SIZE[1] * SIZE[2]), ...SIZE);
    Object.assign(texture, { format: RedFormat, type: UnsignedByteType, minFilter: NearestFilter, magFilter: NearestFilter });
    texture.unpackAlignment = 1;
    texture.needsUpdate = true;
    this.uniforms = {
      cover: { value: texture },
      page: { value: new Vector3(...this.#size) },
      coverRest: { value: new Vector3() },
      coverWrap: { value: new Vector3() },
      coverDelta: { value: new Vector3(1e6, 0, 0) },
    };
  }

  set({ key }: PageGeometry, drawn: boolean): void {
    if (key.level > 0) return;
    const [x, y, z] = [wrapInto(key.tx, SIZE[0]), wrapInto(key.ty, SIZE[1]), wrapInto(key.layer, SIZE[2])];
    const texture = this.uniforms.cover.value;
    (texture.image.data as Uint8Array)[(z * SIZE[1] + y) * SIZE[0] + x] = drawn ? COVERED : 0;
    texture.needsUpdate = true;
  }

  /** Follows the scene's origin and the camera. */
  follow(origin: Vec3, camera: Vec3): void {
    const { coverRest, coverWrap, coverDelta } = this.uniforms;
    for (const axis of [0, 1, 2] as const) {
      const [size, count] = [this.#size[axis], SIZE[axis]];
      const first = Math.floor(origin[axis] / size);
      coverRest.value.setComponent(axis, origin[axis] - first * size);
      coverWrap.value.setComponent(axis, wrapInto(first, count));
      coverDelta.value.setComponent(axis, first - Math.floor(camera[axis] / size));
    }
  }

  clear(): void {
    this.uniforms.cover.value.dispose();
  }
}
