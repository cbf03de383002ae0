// The pages of an archive as meshes, relative to a local origin near the camera, where 32 bits on the graphics card are
// exact to a tenth of a millimetre whatever the coordinates of the scan.

import type { Bounds, PageColours, PageGeometry, Vec3 } from "slicewalk";
import {
  Box3,
  BufferAttribute,
  BufferGeometry,
  Frustum,
  Group,
  Matrix4,
  Mesh,
  Sphere,
  Vector3,
  Vector4,
  type Camera,
} from "three";
import { distance } from "../geometry";
import { Cover } from "./cover";
import { Exposure } from "./exposure";
import { type Effort, Shading } from "./material";
import { forget, meanOf, type Paint, paintOf, PLAIN } from "./paint";

/** Distance from the local origin beyond which another one is chosen. */
const NEAR_ORIGIN_M = 500;
/** Time and bytes per frame for uploading new pages to the graphics card. */
const UPLOAD_MS = 4;
const UPLOAD_BYTES = 1 << 20;
/** Pixels along an edge of a page. */
const PAGE_PIXELS = 64;

const NO_COLOUR = new Vector4();

interface Drawn {
  readonly mesh: Mesh;
  readonly page: PageGeometry;
  readonly box: Box3;
  readonly bytes: number;
}

export class World {
  readonly group = new Group();
  readonly shading: Shading;
  /** Position of the scene's (0, 0, 0) in the scan. */
  origin: Vec3 = [0, 0, 0];
  /** Whether the archive is drawn beside what lies over it. */
  matter = true;
  triangles = 0;
  bytes = 0;
  /** Another number after each change of what is drawn. */
  revision = 0;
  readonly #drawn = new Map<number, Drawn>();
  readonly #waiting = new Map<number, PageGeometry>();
  /** Colours by page, and those that arrived since. */
  readonly #paints = new Map<number, Paint>();
  readonly #exposure = new Exposure();
  /** Colours of pages whose own are still to come: the means of the overview pages around them. */
  readonly #usuals = new Map<number, Vector4>();
  readonly #unmixed = new Map<number, PageColours>();
  readonly #frustum = new Frustum();
  readonly #matrix = new Matrix4();

  readonly #cover: Cover;

  constructor(
    readonly pixelSize: number,
    readonly sliceHeight: number,
  ) {
    this.#cover = new Cover(pixelSize, sliceHeight);
    this.shading = new Shading(this.#cover);
  }

  /**
   * Chooses another local origin if `at` is far from this one; it lies on a boundary of slices, so that slices are
   * counted exactly.
   */
  moveOrigin(at: Vec3): boolean {
    if (distance(at, this.origin) < NEAR_ORIGIN_M) return false;
    const round = (value: number, step: number): number => Math.round(value / step) * step;
    this.origin = [round(at[0], 64), round(at[1], 64), round(at[2], this.sliceHeight)];
    this.#drawn.forEach((drawn) => this.#place(drawn));
    return true;
  }

  /** Converts to coordinates of the scene. */
  local(at: Vec3): Vector3 {
    return new Vector3(at[0] - this.origin[0], at[1] - this.origin[1], at[2] - this.origin[2]);
  }

  world(at: { x: number; y: number; z: number }): Vec3 {
    return [at.x + this.origin[0], at.y + this.origin[1], at.z + this.origin[2]];
  }

  /** Number of pages drawn in full and of an overview level, and of those with colours in each. */
  get counts(): { pages: number; overview: number; coloured: number; distant: number } {
    const overview = [...this.#drawn.values()].filter(({ page }) => page.key.level > 0);
    const distant = overview.filter(({ page }) => this.#paints.has(page.id)).length;
    const pages = this.#drawn.size - overview.length;
    return { pages, overview: overview.length, coloured: this.#paints.size - distant, distant };
  }

  /** Pages that arrived and are not drawn yet. */
  get waiting(): number {
    return this.#waiting.size;
  }

  take(page: PageGeometry): void {
    this.#waiting.set(page.id, page);
  }

  /** Stores the colours of a page; they may arrive before the page is drawn, and stay when it is rebuilt. */
  colour(colours: PageColours): void {
    this.#unmixed.set(colours.id, colours);
  }

  drop(id: number): void {
    this.#bleach(id);
    this.#unmixed.delete(id);
    this.#take(id);
  }

  #bleach(id: number): void {
    const paint = this.#paints.get(id);
    if (paint === undefined) return;
    this.#paints.delete(id);
    this.bytes -= paint.bytes;
    this.revision += 1;
    forget(paint);
  }

  /** Removes the geometry of a page. */
  #take(id: number): void {
    this.#waiting.delete(id);
    const drawn = this.#drawn.get(id);
    if (drawn === undefined) return;
    this.#drawn.delete(id);
    this.#usuals.delete(id);
    this.group.remove(drawn.mesh);
    drawn.mesh.geometry.dispose();
    this.triangles -= drawn.page.indices.length / 3;
    this.bytes -= drawn.bytes;
    this.revision += 1;
    this.#cover.set(drawn.page, false);
  }

  clear(): void {
    [...this.#waiting.keys(), ...this.#drawn.keys()].forEach((id) => this.drop(id));
    this.#cover.clear();
  }

  /** Sets what the shaders do. */
  set effort(effort: Effort) {
    this.shading.effort = effort;
    this.revision += 1;
    this.#drawn.forEach(({ mesh, page }) => (mesh.material = this.shading.material(page.key.level)));
  }

  /** Adds arrived pages, for as long as a frame can spare. */
  settle(): void {
    const end = performance.now() + UPLOAD_MS;
    let bytes = 0;
    for (const [id, page] of this.#waiting) {
      this.#take(id);
      if (page.indices.length > 0) bytes += this.#add(page);
      if (bytes > UPLOAD_BYTES || performance.now() > end) return;
    }
    // Colours come after shapes.
    for (const [id, colours] of this.#unmixed) {
      this.#unmixed.delete(id);
      this.#bleach(id);
      const paint = paintOf(colours);
      this.#exposure.take(colours);
      if ((this.#drawn.get(id)?.page.key.level ?? 0) > 0) this.#usuals.clear();
      this.shading.uniforms.exposure.value.set(...this.#exposure.range);
      this.#paints.set(id, paint);
      this.revision += 1;
      this.bytes += paint.bytes;
      bytes += paint.bytes;
      if (bytes > UPLOAD_BYTES || performance.now() > end) return;
    }
  }

  /** Shows what the camera sees; pages around `eye` are drawn in full. */
  cull(camera: Camera, eye: Vec3): number {
    this.#cover.follow(this.origin, eye);
    this.#matrix.multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse);
    this.#frustum.setFromProjectionMatrix(this.#matrix);
    let seen = 0;
    for (const { mesh, box, page } of this.#drawn.values()) {
      mesh.visible = this.#frustum.intersectsBox(box);
      seen += mesh.visible ? page.indices.length / 3 : 0;
    }
    return seen;
  }

  /** Lowest and highest height drawn. */
  heights(): readonly [number, number] | null {
    let [low, high] = [Infinity, -Infinity];
    for (const { page } of this.#drawn.values()) {
      low = Math.min(low, page.bounds.min[2]);
      high = Math.max(high, page.bounds.max[2]);
    }
    return low < high ? [low, high] : null;
  }

  /** Uploads a page; returns its bytes on the graphics card. */
  #add(page: PageGeometry): number {
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(page.positions, 3));
    geometry.setAttribute("normal", new BufferAttribute(page.normals, 4, true));
    geometry.setAttribute("attributes", new BufferAttribute(page.attributes, 4));
    geometry.setIndex(new BufferAttribute(page.indices, 1));
    // Boxes of the world decide what is drawn; computing three.js' own sphere would visit all vertices.
    geometry.boundingSphere = new Sphere(new Vector3(), Infinity);
    const mesh = new Mesh(geometry, this.shading.material(page.key.level));
    mesh.frustumCulled = false;
    const coarser = 4 ** page.key.level;
    const edge = this.pixelSize * PAGE_PIXELS * coarser;
    const share = new Vector3(page.scale[0] / edge, page.scale[1] / edge, page.scale[2] / (this.sliceHeight * coarser));
    const { id } = page;
    mesh.onBeforeRender = (_renderer, _scene, _camera, _geometry, material) => {
      const paint = this.#paints.get(id);
      this.shading.paint(material, paint ?? PLAIN, share, paint ? NO_COLOUR : this.#usual(page));
    };
    mesh.matrixAutoUpdate = false;
    const arrays = [page.positions, page.normals, page.attributes, page.indices];
    const drawn = { mesh, page, box: new Box3(), bytes: arrays.reduce((sum, array) => sum + array.byteLength, 0) };
    this.#place(drawn);
    this.#drawn.set(page.id, drawn);
    this.#cover.set(page, true);
    this.group.add(mesh);
    this.triangles += page.indices.length / 3;
    this.bytes += drawn.bytes;
    this.revision += 1;
    return drawn.bytes;
  }

  /** The mean colour of the overview page around a page. */
  #usual({ id, key }: PageGeometry): Vector4 {
    const known = this.#usuals.get(id);
    if (known !== undefined || key.level > 0) return known ?? NO_COLOUR;
    const usual = this.#overviewColour(key);
    this.#usuals.set(id, usual);
    return usual;
  }

  #overviewColour(key: PageGeometry["key"]): Vector4 {
    for (const { page } of this.#drawn.values()) {
      const { level, tx, ty, layer } = page.key;
      const wide = 4 ** level;
      const holds = (at: number, of: number): boolean => Math.floor(of / wide) === at;
      if (level === 0 || !holds(tx, key.tx) || !holds(ty, key.ty) || !holds(layer, key.layer)) continue;
      const paint = this.#paints.get(page.id);
      return paint === undefined ? NO_COLOUR : meanOf(paint);
    }
    return NO_COLOUR;
  }

  #place({ mesh, page, box }: Drawn): void {
    mesh.position.copy(this.local(page.origin));
    mesh.scale.set(...(page.scale as [number, number, number]));
    mesh.updateMatrix();
    const corners = page.bounds satisfies Bounds;
    box.set(this.local(corners.min), this.local(corners.max));
  }
}
