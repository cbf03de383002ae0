// The drawing of a storey in the plan view, pixel by pixel, with a grid and a scale bar.

import type { Archive } from "slicewalk";
import {
  BufferAttribute,
  BufferGeometry,
  DataTexture,
  Group,
  LinearMipmapLinearFilter,
  LineBasicMaterial,
  LineSegments,
  Mesh,
  MeshBasicMaterial,
  NearestFilter,
  SRGBColorSpace,
} from "three";
import type { World } from "../scene/world";
import type { Theme } from "../scene/sky";
import { BELOW, CUT, draw, FLOOR, UNKNOWN, type Area, type Drawing } from "./drawing";

const CELLS = 1024;
/** What is drawn beyond the picture, as a share of it, so that moving does not redraw each time. */
const MORE = 0.25;
/** Interval of drawing while pages arrive (ms). */
const OFTEN_MS = 700;
/** A drawing that has become this much finer or coarser than the picture is made anew. */
const COARSER = 1.6;
const STEPS_M = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000];
/** Least distance of the grid's lines (pixels of the screen). */
const GRID_PX = 56;

type Rgba = readonly [number, number, number, number];
const INKS: Record<Theme, Partial<Record<number, Rgba>>> = {
  light: {
    [FLOOR]: [255, 255, 255, 255],
    [BELOW]: [205, 209, 212, 255],
    [CUT]: [17, 19, 22, 255],
    [UNKNOWN]: [120, 126, 132, 60],
  },
  dark: { [FLOOR]: [43, 49, 57, 255], [BELOW]: [79, 88, 99, 255], [CUT]: [238, 240, 243, 255], [UNKNOWN]: [160, 166, 172, 60] },
};
const GRID: Record<Theme, string> = { light: "#7d8791", dark: "#8d97a1" };

/** What the plan view shows. */
export interface Shown {
  readonly area: Area;
  readonly floor: number;
  readonly theme: Theme;
  /** Whether only what is cut is drawn, over the colours of the rest. */
  readonly onlyCut: boolean;
  /** Height of the picture in pixels of the screen. */
  readonly pixelsHigh: number;
}

export class Sheet {
  readonly group = new Group();
  /** Metres between two lines of the grid. */
  step = 1;
  /** Another number after each change of what is drawn. */
  revision = 0;
  readonly #page: Mesh<BufferGeometry, MeshBasicMaterial>;
  readonly #grid = new LineSegments(
    new BufferGeometry(),
    new LineBasicMaterial({ transparent: true, opacity: 0.3, depthTest: false }),
  );
  #drawing: Drawing | null = null;
  #asked: { shown: Shown; loaded: number; at: number } | null = null;
  #painted = "";
  #gridded = "";
  #busy = false;

  constructor(readonly archive: Archive) {
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(new Float32Array(12), 3));
    // The first row of the texture is the greatest y.
    geometry.setAttribute("uv", new BufferAttribute(new Float32Array([0, 1, 1, 1, 1, 0, 0, 0]), 2));
    geometry.setIndex([0, 1, 2, 0, 2, 3]);
    this.#page = new Mesh(geometry, new MeshBasicMaterial({ transparent: true, depthTest: false, toneMapped: false }));
    this.#page.frustumCulled = this.#grid.frustumCulled = false;
    this.#page.renderOrder = -2;
    this.#grid.renderOrder = -1;
    this.group.add(this.#page, this.#grid);
    this.group.visible = false;
  }

  /** Shows the drawing, or null: hides it. Call it with every frame. */
  update(world: World, shown: Shown | null): void {
    this.group.visible = shown !== null;
    if (shown === null) return;
    if (!this.#busy && this.#isOld(shown)) void this.#draw(shown);
    this.#paint(shown);
    this.#place(world, shown);
  }

  /** Frees what it drew. */
  close(): void {
    this.group.removeFromParent();
    this.#page.material.map?.dispose();
    for (const part of [this.#page, this.#grid]) {
      part.geometry.dispose();
      part.material.dispose();
    }
  }

  #isOld(shown: Shown): boolean {
    const asked = this.#asked;
    if (asked === null || Math.abs(asked.shown.floor - shown.floor) > 0.05) return true;
    const [x0, y0, x1, y1] = asked.shown.area;
    const [left, low, right, high] = shown.area;
    const size = (right - left) / (x1 - x0);
    if (left < x0 || low < y0 || right > x1 || high > y1 || size < 1 / (1 + 2 * MORE) / COARSER) return true;
    return this.archive.stats.loaded !== asked.loaded && performance.now() - asked.at > OFTEN_MS;
  }

  async #draw(shown: Shown): Promise<void> {
    const [x0, y0, x1, y1] = shown.area;
    const [wide, high] = [(x1 - x0) * MORE, (y1 - y0) * MORE];
    const area = [x0 - wide, y0 - high, x1 + wide, y1 + high] as const;
    this.#busy = true;
    this.#asked = { shown: { ...shown, area }, loaded: this.archive.stats.loaded, at: performance.now() };
    try {
      const { floor } = shown;
      this.#drawing = await draw(this.archive, { area, floor, cells: CELLS, load: false }, new AbortController().signal);
      this.#painted = "";
    } catch {
      // A closed or failed archive is reported elsewhere.
    } finally {
      this.#busy = false;
    }
  }

  #paint({ theme, onlyCut }: Shown): void {
    const key = `${theme} ${onlyCut}`;
    const drawing = this.#drawing;
    if (drawing === null || this.#painted === key) return;
    this.#painted = key;
    this.revision += 1;
    const inks = INKS[theme];
    const pixels = new Uint8Array(4 * drawing.cells.length);
    drawing.cells.forEach((kind, n) => {
      const ink = onlyCut && kind !== CUT ? undefined : inks[kind];
      if (ink !== undefined) pixels.set(ink, 4 * n);
    });
    const texture = new DataTexture(pixels, drawing.width, drawing.height);
    texture.colorSpace = SRGBColorSpace;
    texture.magFilter = NearestFilter;
    texture.minFilter = LinearMipmapLinearFilter;
    texture.generateMipmaps = true;
    texture.needsUpdate = true;
    const { material } = this.#page;
    material.map?.dispose();
    if (material.map === null) material.needsUpdate = true;
    material.map = texture;
  }

  #place(world: World, { area, floor, theme, pixelsHigh }: Shown): void {
    const [x0, y0, x1, y1] = area;
    const metresPerPixel = (y1 - y0) / Math.max(pixelsHigh, 1);
    this.step = STEPS_M.find((step) => step >= GRID_PX * metresPerPixel) ?? (STEPS_M.at(-1) as number);
    const origin = world.origin.join();
    const key = [origin, theme, ...area, this.#painted, this.#drawing?.min.join()].join();
    if (key === this.#gridded) return;
    this.#gridded = key;
    this.revision += 1;
    const local = (x: number, y: number): readonly [number, number, number] => {
      const { x: i, y: j, z } = world.local([x, y, floor]);
      return [i, j, z];
    };
    const drawing = this.#drawing;
    this.#page.visible = drawing !== null;
    if (drawing !== null) {
      const { min, cell, width, height } = drawing;
      const max = [min[0] + cell * width, min[1] + cell * height] as const;
      const corners = [local(min[0], min[1]), local(max[0], min[1]), local(max[0], max[1]), local(min[0], max[1])];
      const places = this.#page.geometry.getAttribute("position");
      corners.forEach(([x, y, z], n) => places.setXYZ(n, x, y, z));
      places.needsUpdate = true;
    }
    const lines: number[] = [];
    const { step } = this;
    for (let x = Math.ceil(x0 / step) * step; x <= x1; x += step) lines.push(...local(x, y0), ...local(x, y1));
    for (let y = Math.ceil(y0 / step) * step; y <= y1; y += step) lines.push(...local(x0, y), ...local(x1, y));
    const { geometry, material } = this.#grid;
    geometry.dispose();
    geometry.setAttribute("position", new BufferAttribute(new Float32Array(lines), 3));
    material.color.setStyle(GRID[theme]);
  }
}
